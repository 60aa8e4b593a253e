#!/usr/bin/env bash
# What a stranger meets: a Debian with nothing but make and Python, a copy of these sources, `make demo`.
#     tools/fresh.sh DIR [SUITE]
# As root on Debian.  DIR, which must not exist, becomes the machine (a chroot; 3 GB; delete it afterwards); SUITE is trixie
# (Python 3.13, so Blender 5.2) or bookworm (Python 3.11, Blender 4.5).  Last line: the picture that the demo drew.
set -euo pipefail
root=${1:?tools/fresh.sh DIR [SUITE]}
suite=${2:-trixie}
cd "$(dirname "$0")/.."

fail() { echo "fresh: $*" >&2; exit 1; }
[ "$(id -u)" = 0 ] || fail "needs root"
command -v debootstrap >/dev/null || fail "needs debootstrap: apt-get install debootstrap"
[ ! -e "$root" ] || fail "$root is there; choose another folder"

# shellcheck disable=SC2016
mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 2>/dev/null | awk '/debian\// && !n++')
echo "fresh: Debian $suite in $root"
debootstrap --variant=minbase "$suite" "$root" "$mirror" >"$root.log" 2>&1 ||
    { tail -n 15 "$root.log" >&2; fail "debootstrap failed"; }
# A mirror may be a snapshot of some past day, whose Release files count as expired.
printf 'Acquire::Check-Valid-Until "false";\nAcquire::Check-Date "false";\n' >"$root/etc/apt/apt.conf.d/99snapshot"
cp -L /etc/resolv.conf "$root/etc/resolv.conf"
cp -L /etc/ssl/certs/ca-certificates.crt "$root/etc/this-machines.crt"  # it may be behind a proxy with its own
mkdir -p "$root/home/stranger/irpso"
git ls-files -z --cached --others --exclude-standard | xargs -0 tar -c | tar -x -C "$root/home/stranger/irpso"

# shellcheck disable=SC2016
unshare --mount --propagation private sh -euc '
    root=$1; crt=/etc/this-machines.crt
    mount -t proc proc "$root/proc"; mount --rbind /dev "$root/dev"
    exec chroot "$root" env DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin \
        SSL_CERT_FILE=$crt REQUESTS_CA_BUNDLE=$crt PIP_CERT=$crt sh -euxc "
            apt-get update -qq
            apt-get install -y -qq --no-install-recommends make python3 >/dev/null
            cd /home/stranger/irpso
            make demo"' sh "$root" </dev/null
picture=$(find "$root/home/stranger/irpso/build/demo" -name demo.jpg)
[ -s "$picture" ] || fail "no picture"
echo "$picture"
