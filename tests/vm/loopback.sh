#!/usr/bin/env bash
# Builds v4l2loopback for the kernel that kernel.sh unpacked, without installing anything: loopback.sh KERNEL_FOLDER
# Afterwards guest.sh can load it. Nothing is done where it is there already.
# Exit status 77: a package cannot be fetched here.
set -euo pipefail
kernel=$1
[[ -e "$kernel/version" ]] || { echo "skipped: no kernel in $kernel"; exit 77; }
version=$(cat "$kernel/version")
module="$kernel/modules/updates/v4l2loopback.ko"
# The list of modules may have been made anew without it.
[[ -e "$module" ]] && grep -q '^updates/v4l2loopback.ko:' "$kernel/modules/modules.dep" && exit 0
staging=$(mktemp -d "${kernel%/}-loopback.XXXXXX")
trap 'rm -rf "$staging"' EXIT
packages=("linux-headers-$version" "linux-headers-${version%-amd64}-common" "linux-kbuild-${version%%.0-*}"
          v4l2loopback-dkms)
download() { (cd "$staging" && apt-get download -qq -o APT::Sandbox::User=root "${packages[@]}"); }
download || { apt-get update -qq && download; } ||
  { echo "skipped: no kernel headers: apt cannot fetch ${packages[*]}"; exit 77; }
for package in "$staging"/*.deb; do dpkg-deb -x "$package" "$staging"; done
headers="$staging/usr/src/linux-headers-$version"
# The headers name their other half by the place where it would be installed.
sed -i "s|/usr/src/|$(realpath "$staging")/usr/src/|" "$headers/Makefile"
source=$(realpath "$staging"/usr/src/v4l2loopback-*)
make -s -C "$headers" M="$source" modules
mkdir -p "$kernel/modules/updates"
strip --strip-debug -o "$staging/v4l2loopback.ko" "$source/v4l2loopback.ko"
mv "$staging/v4l2loopback.ko" "$module"
depmod -b "$kernel/root" "$version"
