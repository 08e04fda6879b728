#!/usr/bin/env bash
# Check that the browser for the viewer's tests is installed; if not, install it where we are allowed to (Debian, Ubuntu).
set -euo pipefail
packages=(chromium chromium-driver)

if command -v chromium >/dev/null && command -v chromedriver >/dev/null; then
  exit 0
fi

exec bash "$(dirname "$0")/apt_install.sh" "the viewer is tested in Chromium" "${packages[@]}"
