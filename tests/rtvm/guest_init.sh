#!/bin/busybox sh
# SPDX-License-Identifier: Apache-2.0
# The first process of the guest: mounts the machine's files read-only under a layer of memory, then
# runs the guest script that the kernel command line names (holdfast.script=PATH, holdfast.modules=PATH).
box=/bin/busybox
$box mount -t proc none /proc
$box mount -t sysfs none /sys
$box mount -t devtmpfs none /dev
while read -r module; do $box insmod "/modules/$module"; done < /modules/order

for word in $($box cat /proc/cmdline); do
  case $word in
    holdfast.script=*) script=${word#*=} ;;
    holdfast.modules=*) modules=${word#*=} ;;
  esac
done

# loose: the host's files do not change while the guest runs
$box mount -t 9p -o ro,trans=virtio,version=9p2000.L,msize=512000,cache=loose host /host
$box mount -t tmpfs none /upper
$box mkdir /upper/files /upper/work
$box mount -t overlay -o lowerdir=/host,upperdir=/upper/files,workdir=/upper/work none /root
for place in proc sys dev; do $box mount --move /$place /root/$place; done
$box mkdir -p /root/dev/shm /root/dev/pts "/root/lib/modules/$($box uname -r)"
$box mount -t tmpfs none /root/dev/shm
$box mount -t tmpfs none /root/run
$box mount -t devpts none /root/dev/pts
$box mount -t tracefs none /root/sys/kernel/tracing
$box mount --bind "/root$modules" "/root/lib/modules/$($box uname -r)"
exec $box chroot /root /bin/bash "$script"
