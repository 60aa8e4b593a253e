#!/usr/bin/env bash
# A Blender with a window, for the tests in tests/gui: tools/gui_setup.sh [--root DIR]
# On Debian, as root: Debian unstable's Blender in a folder of its own (chroot), with software OpenGL and
# Vulkan, and Xvfb on this machine.  2 GB and some minutes the first time; safe to run again, and then at once ready.
# The last line printed is the program to run: it starts that Blender, which sees the current folder at its own path.
# It mounts for itself alone, so that the folder can be deleted at any time.
set -euo pipefail
root=/opt/blender-gui
[ "${1:-}" != --root ] || root=${2:?}

# The last line: what Debian's Blender needs and does not ask for; without it Blender's own add-ons do not start.
packages=(blender libgl1-mesa-dri libegl1 libgl1 libegl-mesa0 mesa-vulkan-drivers fonts-dejavu-core
    python3-numpy python3-openimageio python3-requests python3-cattr python3-zstandard)

fail() { echo "gui_setup: $*" >&2; exit 1; }
say() { echo "gui_setup: $*" >&2; }
has() { dpkg-query ${2:+"--admindir=$2"} -W -f '${db:Status-Status}' "$1" 2>/dev/null | grep -qx installed; }

# inside ROOT COMMAND...: runs it in ROOT with /proc and /dev, which end with it.
inside() {
    # shellcheck disable=SC2016
    unshare --mount --propagation private sh -euc '
        root=$1; shift
        mount -t proc proc "$root/proc"; mount --rbind /dev "$root/dev"
        exec chroot "$root" env DEBIAN_FRONTEND=noninteractive LC_ALL=C "$@"' sh "$@" >>"$log" 2>&1 </dev/null ||
        { tail -n 15 "$log" >&2; fail "'${*:2}' failed"; }
}

own="or give the tests a Blender that is there: BLENDER=/path/to/blender"
[ "$(id -u)" = 0 ] || fail "needs root; $own"
command -v apt-get >/dev/null || fail "needs Debian; $own"
case $root in /?*) ;; *) fail "--root must be an absolute path" ;; esac
log=$(mktemp)
trap 'rm -f "$log"' EXIT

host=()
for package in xvfb debootstrap; do has $package || host+=($package); done
if [ ${#host[@]} -gt 0 ]; then
    say "apt-get install ${host[*]}"
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "${host[@]}" >/dev/null
fi

if [ ! -x "$root/usr/bin/apt-get" ]; then
    [ ! -e "$root" ] || rmdir "$root" || fail "$root is there and is no Debian: delete it, or choose another --root"
    # shellcheck disable=SC2016
    mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 2>/dev/null | awk '/debian\// && !n++') || mirror=
    [ -n "$mirror" ] || fail "apt names no Debian mirror; $own"
    say "debootstrap of Debian unstable from $mirror into $root"
    rm -rf --one-file-system "$root.partial"
    debootstrap --variant=minbase sid "$root.partial" "$mirror" >"$log" 2>&1 ||
        { tail -n 15 "$log" >&2; fail "debootstrap failed"; }
    # A mirror may be a snapshot of some past day, whose Release files count as expired.
    printf 'Acquire::Check-Valid-Until "false";\nAcquire::Check-Date "false";\n' \
        >"$root.partial/etc/apt/apt.conf.d/99snapshot"
    printf '#!/bin/sh\nexit 101\n' >"$root.partial/usr/sbin/policy-rc.d"  # no services
    chmod +x "$root.partial/usr/sbin/policy-rc.d"
    ln -sfn /proc/mounts "$root.partial/etc/mtab"  # Blender looks for it
    mv "$root.partial" "$root"
fi
missing=()
for package in "${packages[@]}"; do has "$package" "$root/var/lib/dpkg" || missing+=("$package"); done
if [ ${#missing[@]} -gt 0 ]; then
    say "installing ${missing[*]}"
    cp -L /etc/resolv.conf "$root/etc/resolv.conf"
    inside "$root" apt-get update
    inside "$root" apt-get install -y --no-install-recommends "${missing[@]}"
    inside "$root" apt-get clean
fi

cat >"$root/run-blender" <<END
#!/bin/sh
exec unshare --mount --propagation private sh -euc '
    mount -t proc proc "\$0/proc"; mount --rbind /dev "\$0/dev"
    mkdir -p "\$0\$PWD"; mount --bind "\$PWD" "\$0\$PWD"
    exec chroot "\$0" env -C "\$PWD" blender "\$@"' "$root" "\$@"
END
chmod +x "$root/run-blender"
echo "$root/run-blender"
