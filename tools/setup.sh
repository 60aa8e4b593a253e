#!/usr/bin/env bash
# Makes the development environment: tools/setup.sh VENV [PYTHON]
# Finds a Python, installs Blender's system libraries where it may, then the pinned packages.  Safe to run again.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=$1
python=${2:-}

libraries=(libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 libegl1)

fail() { echo "setup: $*" >&2; exit 1; }

version_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || true; }

# Prints the first interpreter that really is Python $1 (a pyenv shim may exist and not run).
find_python() {
    local candidate
    for candidate in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$1".*/bin/python3 python3; do
        if [ "$(version_of "$candidate")" = "$1" ]; then command -v "$candidate"; return; fi
    done
    return 1
}

if [ "$venv" = --find ]; then find_python "$python"; exit; fi

[ ! -L "$venv" ] || fail "'$venv' is a link, and what it leads to would be emptied; remove the link, or say" \
    "'make VENV=another folder'"

if [ -z "$python" ]; then
    python=$(find_python 3.13 || find_python 3.11) || fail "no Python 3.13 or 3.11 here (the two that Blender's" \
        "long-term releases come for); install one, or say 'make PYTHON=/path/to/python3.13'"
fi
case "$(version_of "$python")" in
    3.13 | 3.11) ;;
    "") fail "'$python' does not run; say 'make PYTHON=/path/to/python3.13'" ;;
    *) fail "'$python' is Python $(version_of "$python"); want 3.13 (Blender 5.2 LTS) or 3.11 (Blender 4.5 LTS)" ;;
esac

if command -v apt-get >/dev/null && command -v dpkg-query >/dev/null; then
    "$python" -c 'import ensurepip' 2>/dev/null || libraries+=("python$(version_of "$python")-venv")
    missing=()
    for package in "${libraries[@]}"; do
        dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null | grep -qx installed || missing+=("$package")
    done
    if [ ${#missing[@]} -gt 0 ]; then
        install="apt-get install -y --no-install-recommends ${missing[*]}"
        [ "$(id -u)" = 0 ] || fail "Blender's module needs system libraries; run: sudo $install"
        echo "setup: $install"
        export DEBIAN_FRONTEND=noninteractive
        apt-get update -qq
        $install -qq >/dev/null
    fi
fi

echo "setup: $venv from $python ($(version_of "$python"))"
"$python" -m venv --clear "$venv"
"$venv/bin/python" -m pip install --quiet --no-compile --disable-pip-version-check --no-deps \
    -r requirements-dev.txt -r requirements-docs.txt
"$venv/bin/python" -c 'import bpy, moderngl, OpenImageIO' ||
    fail "the environment does not load; the message above names what is missing"
cat requirements-dev.txt requirements-docs.txt tools/setup.sh >"$venv/.ready"
