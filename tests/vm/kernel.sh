#!/usr/bin/env bash
# Unpacks Debian's kernel beside the build, without installing it: kernel.sh FOLDER
# Afterwards FOLDER/vmlinuz and FOLDER/modules stand there. Nothing is done where they do already.
# Exit status 77: the package cannot be fetched here.
set -euo pipefail
folder=$1
[[ -e "$folder/vmlinuz" && -e "$folder/modules/modules.dep" ]] && exit 0
staging=$(mktemp -d "${folder%/}.XXXXXX")
trap 'rm -rf "$staging"' EXIT
download() {
  package=$(apt-cache depends linux-image-amd64 | sed -n 's/^ *Depends: \(linux-image-[0-9].*\)/\1/p' | head -1)
  [[ -n "$package" ]] && (cd "$staging" && apt-get download -qq -o APT::Sandbox::User=root "$package")
}
# Package lists that are too old name a kernel that is no longer there.
download || { apt-get update -qq && download; } || {
  echo "skipped: no kernel: apt cannot fetch linux-image-amd64"
  exit 77
}
dpkg-deb --fsys-tarfile "$staging"/*.deb |
  tar -x -C "$staging" --wildcards './boot/vmlinuz-*' './lib/modules/*'
mkdir -p "$staging/out"
mv "$staging"/boot/vmlinuz-* "$staging/out/vmlinuz"
mv "$staging"/lib/modules/* "$staging/out/modules"
# modprobe wants lib/modules/VERSION below a root of its own.
version=$(basename "$package") && version=${version#linux-image-}
mkdir -p "$staging/out/root/lib/modules"
ln -s ../../../modules "$staging/out/root/lib/modules/$version"
echo "$version" > "$staging/out/version"
depmod -b "$staging/out/root" "$version"
rm -rf "$folder"
mv "$staging/out" "$folder"
