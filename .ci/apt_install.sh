#!/usr/bin/env bash
# Install Debian packages if we are allowed to: apt_install.sh WHAT PACKAGE...
# If not, or on other systems, print WHAT (what is missing, and for what) and exit with code 1.
set -euo pipefail
what=$1
shift

as_root=
if [ "$(id -u)" != 0 ]; then
  as_root="sudo -n"
fi
if ! command -v apt-get >/dev/null || ! $as_root true 2>/dev/null; then
  echo "$what; on Debian 12 or later: apt-get install $*" >&2
  exit 1
fi
echo "installing $*"
$as_root apt-get update -qq
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes --no-install-recommends "$@" >/dev/null
