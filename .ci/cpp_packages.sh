#!/usr/bin/env bash
# Check that everything the C++ client is built with is installed; if not, install it where we are allowed to (Debian,
# Ubuntu), and elsewhere say what is missing.
set -euo pipefail
packages=(cmake g++ ninja-build pkg-config libgrpc++-dev libprotobuf-dev protobuf-compiler protobuf-compiler-grpc libgtest-dev
  clang-tidy)

missing=()
for tool in cmake g++ ninja pkg-config protoc grpc_cpp_plugin clang-tidy; do
  command -v "$tool" >/dev/null || missing+=("$tool")
done
for library in grpc++ protobuf gtest; do
  pkg-config --exists "$library" 2>/dev/null || missing+=("$library")
done
if [ ${#missing[@]} = 0 ]; then
  exit 0
fi

if ! bash "$(dirname "$0")/apt_install.sh" "the C++ client needs ${missing[*]}" "${packages[@]}"; then
  echo "(make test CPP=no tests everything else)" >&2
  exit 1
fi
