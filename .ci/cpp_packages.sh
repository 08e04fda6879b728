#!/usr/bin/env bash
# See that what the C++ client is built with is there; where we may, install what is missing (Debian, Ubuntu).
# Other systems, and people who may not install, are told what is missing.
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

as_root=
if [ "$(id -u)" != 0 ]; then
  as_root="sudo -n"
fi
if ! command -v apt-get >/dev/null || ! $as_root true 2>/dev/null; then
  echo "the C++ client needs ${missing[*]}; on Debian 12 or later: apt-get install ${packages[*]}" >&2
  echo "(make test CPP=no tests everything else)" >&2
  exit 1
fi
echo "installing ${packages[*]}"
$as_root apt-get update -qq
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes --no-install-recommends "${packages[@]}" >/dev/null
