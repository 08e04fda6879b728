#!/usr/bin/env bash
# See that the browser that the viewer is tested in is there; where we may, install it (Debian, Ubuntu).
set -euo pipefail
packages=(chromium chromium-driver)

if command -v chromium >/dev/null && command -v chromedriver >/dev/null; then
  exit 0
fi

exec bash "$(dirname "$0")/apt_install.sh" "the viewer is tested in Chromium" "${packages[@]}"
