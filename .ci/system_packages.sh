#!/usr/bin/env bash
# See that the programs that deploy/ is tried with are there; where we may, install them (Debian, Ubuntu).
set -euo pipefail
declare -A packages=(
  [redis-server]=redis-server [haproxy]=haproxy [nginx]=nginx-light [prometheus]=prometheus [promtool]=prometheus
  [buildah]=buildah [mmdebstrap]=mmdebstrap [systemd-analyze]=systemd [openssl]=openssl
)

missing=()
for program in "${!packages[@]}"; do
  command -v "$program" >/dev/null || missing+=("${packages[$program]}")
done
if ! command -v kubectl >/dev/null; then
  echo "kubectl 1.27 or later is not here; Debian's is too old for the overlays of deploy/kubernetes" >&2
  exit 1
fi
if [ ${#missing[@]} = 0 ]; then
  exit 0
fi
as_root=
if [ "$(id -u)" != 0 ]; then
  as_root="sudo -n"
fi
if ! command -v apt-get >/dev/null || ! $as_root true 2>/dev/null; then
  echo "deploy/ is tried with programs that are not here; on Debian 12 or later: apt-get install ${missing[*]}" >&2
  exit 1
fi
echo "installing ${missing[*]}"
$as_root apt-get update -qq
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes --no-install-recommends "${missing[@]}" >/dev/null
