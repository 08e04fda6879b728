#!/usr/bin/env bash
# Create a virtual environment with the first Python of at least 3.11 on the PATH: make_venv.sh FOLDER
# An existing environment is left as it is, except that pip is added if missing. A folder that contains anything else is
# refused. Debian and Ubuntu ship Python without venv: install the missing package if we are allowed to, else name it.
set -euo pipefail
folder=$1

has_pip() {
  "$folder/bin/python" -m pip --version >/dev/null 2>&1
}

if [ -x "$folder/bin/python" ]; then
  if has_pip || { "$folder/bin/python" -m ensurepip >/dev/null 2>&1 && has_pip; }; then
    exit 0
  fi
fi

# An environment that is incomplete, or whose Python no longer exists, is recreated, which empties the folder. Do this
# only if the folder cannot contain anything of the user's.
if [ -e "$folder" ] && [ ! -e "$folder/.ready" ]; then
  if [ -e "$folder/pyvenv.cfg" ]; then
    theirs=$(find "$folder/" -name '*.dist-info' ! -name 'pip-*' ! -name 'setuptools-*' -print -quit)
  else
    theirs=$(find "$folder/" ! -type d ! -name lib64 -print -quit)
  fi
  if [ -n "$theirs" ]; then
    echo "$folder contains $theirs, which creating a virtual environment there would delete: choose another folder" >&2
    exit 1
  fi
fi

python=
for name in python3.12 python3.11 python3.13 python3; do
  if command -v "$name" >/dev/null && "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    python=$name
    break
  fi
done
if [ -z "$python" ]; then
  echo "motiongen needs Python 3.11 or later on the PATH; on Debian 12 or later: apt-get install python3 python3-venv" >&2
  exit 1
fi

if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
  package=$("$python" -c 'import sys; print(f"python3.{sys.version_info.minor}-venv")')
  as_root=
  if [ "$(id -u)" != 0 ]; then
    as_root="sudo -n"
  fi
  if ! command -v apt-get >/dev/null || ! $as_root true 2>/dev/null; then
    echo "$python cannot make virtual environments: install its venv module (Debian, Ubuntu: apt-get install $package)" >&2
    exit 1
  fi
  echo "installing $package"
  $as_root apt-get update -qq
  $as_root apt-get install -qq --yes --no-install-recommends "$package"
fi

"$python" -m venv --clear "$folder"
echo "created $folder with $("$python" --version)"
