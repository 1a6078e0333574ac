#!/usr/bin/env bash
# guest.sh with the virtual USB camera plugged in: uvc_guest.sh UVC_CAMERA KERNEL_FOLDER LIMIT_S COMMAND [ARGUMENTS...]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
camera=$1 kernel=$2 limit_s=$3
shift 3
folder=$(mktemp -d)
"$camera" "$folder/usb" &
device=$!
trap 'kill "$device" 2>/dev/null || true; rm -rf "$folder"' EXIT
for _ in $(seq 50); do [[ -S "$folder/usb" ]] && break; sleep .1; done
# libcamera hears of cameras from udev.
with_udev='export SYSTEMD_IGNORE_CHROOT=1; /lib/systemd/systemd-udevd --daemon 2> /dev/null
  udevadm trigger --subsystem-match=media --subsystem-match=video4linux --subsystem-match=usb; udevadm settle; exec "$@"'
GUEST_QEMU="-device qemu-xhci,id=x -chardev socket,id=c,path=$folder/usb -device usb-redir,chardev=c,bus=x.0" \
  "$here/guest.sh" "$kernel" "xhci_pci; uvcvideo" "$limit_s" /bin/bash -c "$with_udev" udev "$@"
