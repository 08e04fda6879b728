#!/usr/bin/env bash
# See that the programs of `make test-system` are there, besides those of cpp_packages.sh and browser_packages.sh; where
# we may, install them (Debian, Ubuntu).
set -euo pipefail
declare -A packages=(
  [redis-server]=redis-server [haproxy]=haproxy [nginx]=nginx-light [prometheus]=prometheus [promtool]=prometheus
  [buildah]=buildah [mmdebstrap]=mmdebstrap [systemd-analyze]=systemd [openssl]=openssl
  [mcs]=mono-mcs [mono]=mono-runtime [x86_64-w64-mingw32-g++-posix]=g++-mingw-w64-x86-64-posix [npm]=npm
)
# newer than what Debian 12 has: from those who make them
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
    echo "$program is not here: ${others[$program]}; Debian's is too old" >&2
    are_others_here=no
  fi
done
[ $are_others_here = yes ] || exit 1
if [ ${#missing[@]} = 0 ]; then
  exit 0
fi
exec bash "$(dirname "$0")/apt_install.sh" "make test-system takes programs that are not here" "${missing[@]}"
