#!/usr/bin/env bash
# See that the browser that the viewer is tested in is there; where we may, install it (Debian, Ubuntu).
set -euo pipefail
packages=(chromium chromium-driver)

if command -v chromium >/dev/null && command -v chromedriver >/dev/null; then
  exit 0
fi
as_root=
if [ "$(id -u)" != 0 ]; then
  as_root="sudo -n"
fi
if ! command -v apt-get >/dev/null || ! $as_root true 2>/dev/null; then
  echo "the viewer is tested in Chromium; on Debian 12 or later: apt-get install ${packages[*]}" >&2
  exit 1
fi
echo "installing ${packages[*]}"
$as_root apt-get update -qq
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes --no-install-recommends "${packages[@]}" >/dev/null
