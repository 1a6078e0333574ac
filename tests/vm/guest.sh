#!/usr/bin/env bash
# Runs a program of this machine in a guest with Debian's kernel, where the drivers of cameras are real.
# usage: guest.sh KERNEL_FOLDER "MODULE [OPTIONS]; MODULE ..." LIMIT_S COMMAND [ARGUMENTS...]
# The command sees this machine's files, read-only, and an empty /tmp and /run. GUEST_QEMU holds further options of QEMU.
# Exit status: the command's; 124 when the guest was cut off after LIMIT_S or its kernel failed, 77 without a kernel.
set -euo pipefail
kernel=$1 modules=$2 limit_s=$3
shift 3
[[ -e "$kernel/version" ]] || { echo "skipped: no kernel in $kernel"; exit 77; }
work=$(mktemp -d)
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)  # a checkout below /tmp stays visible
trap 'rm -rf "$work"' EXIT
version=$(cat "$kernel/version")

# Paths of modules in the order of loading, with their options.
resolve() {
  tr ';' '\n' <<<"virtio_pci; 9pnet_virtio; 9p; $modules" | while read -r name options; do
    [[ -n "$name" ]] || continue
    modprobe -d "$kernel/root" -S "$version" --show-depends "$name" | sed -n 's/^insmod \([^ ]*\).*/\1/p' |
      sed "\$s|\$| $options|"
  done | awk '!seen[$1]++'
}

mkdir -p "$work"/initramfs/{bin,dev,proc,sys,host,modules}
cp "$(command -v busybox)" "$work/initramfs/bin/"
while read -r path options; do
  cp "$path" "$work/initramfs/modules/"
  echo "insmod /modules/$(basename "$path") $options" >> "$work/load"
done < <(resolve)
printf '%q ' "$@" > "$work/command"
cat > "$work/initramfs/init" <<GUEST
#!/bin/busybox sh
/bin/busybox --install -s /bin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
$(cat "$work/load")
mount -t 9p -o trans=virtio,version=9p2000.L,msize=262144,ro,cache=loose host /host || echo "guest: no host files"
for at in proc sys dev; do mount --bind /\$at /host/\$at; done
mkdir /keep; mount --bind /host$root /keep
for at in tmp run; do mount -t tmpfs none /host/\$at; done
[ -d /host$root ] || { mkdir -p /host$root; mount --bind /keep /host$root; }
mkdir -p /host/dev/shm; mount -t tmpfs none /host/dev/shm
ip link set lo up
cd /
echo "guest: begin"
HOME=/tmp chroot /host /bin/bash -c $(printf '%q' "cd $(printf '%q' "$PWD") && $(cat "$work/command")")
echo "guest: exit \$?"
poweroff -f
GUEST
chmod +x "$work/initramfs/init"
(cd "$work/initramfs" && find . | cpio -o -H newc --quiet | gzip -1) > "$work/initramfs.gz"

# shellcheck disable=SC2086
timeout "$limit_s" qemu-system-x86_64 -accel tcg,thread=multi -cpu max -smp 2 -m 2048 -nographic -no-reboot \
  -monitor none -serial file:"$work/console" -kernel "$kernel/vmlinuz" -initrd "$work/initramfs.gz" \
  -append "console=ttyS0 quiet oops=panic panic=-1" -nic none \
  -fsdev local,id=host,path=/,security_model=none,readonly=on,multidevs=remap \
  -device virtio-9p-pci,fsdev=host,mount_tag=host ${GUEST_QEMU:-} < /dev/null > "$work/qemu" 2>&1 || true
tr -d '\r' < "$work/console" | sed '1,/guest: begin$/d; /^guest: exit/,$d' 
cat "$work/qemu" >&2
status=$(tr -d '\r' < "$work/console" | sed -n 's/^guest: exit \([0-9]*\)$/\1/p' | tail -1)
exit "${status:-124}"
