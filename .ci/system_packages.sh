#!/usr/bin/env bash
# Check that the programs of `make test-system` are installed, besides those of cpp_packages.sh and browser_packages.sh;
# if not, install them where we are allowed to (Debian, Ubuntu).
set -euo pipefail
declare -A packages=(
  [redis-server]=redis-server [haproxy]=haproxy [nginx]=nginx-light [prometheus]=prometheus [promtool]=prometheus
  [buildah]=buildah [mmdebstrap]=mmdebstrap [systemd-analyze]=systemd [openssl]=openssl
  [mcs]=mono-mcs [mono]=mono-runtime [x86_64-w64-mingw32-g++-posix]=g++-mingw-w64-x86-64-posix [npm]=npm
)
# needed newer than in Debian 12, so from their publishers
declare -A others=(
  [kubectl]="kubectl 1.27 or later, for the overlays of deploy/kubernetes"
  [go]="Go 1.23 or later, for the golden messages"
)

missing=()
for program in "${!packages[@]}"; do
  command -v "$program" >/dev/null || missing+=("${packages[$program]}")
done
are_others_here=yes
for program in "${!others[@]}"; do
  if ! command -v "$program" >/dev/null; then
    echo "$program is missing: install ${others[$program]}; Debian's package is too old" >&2
    are_others_here=no
  fi
done
[ $are_others_here = yes ] || exit 1
if [ ${#missing[@]} = 0 ]; then
  exit 0
fi
exec bash "$(dirname "$0")/apt_install.sh" "make test-system needs programs that are missing" "${missing[@]}"
