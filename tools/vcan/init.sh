#!/bin/sh
# FOLDER/init.sh CHANNEL: the first process of the user-mode Linux. It makes the machine ready and runs the
# lines of FOLDER/command. When their files are written, FOLDER/status holds their exit status; "failed" when
# the machine could not be made ready. FOLDER/started exists from the beginning on.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
folder=${0%/*}
channel=$1

finish() {
    sync
    echo "$1" >"$folder/status.new"
    mv "$folder/status.new" "$folder/status"
    sleep 5 # it is ended from outside, as soon as there is a status
    echo o >/proc/sysrq-trigger
    while :; do sleep 1; done
}

set_up() {
    set -e
    mkdir -p /dev/pts /dev/shm
    mount -t devpts -o mode=620,ptmxmode=666 devpts /dev/pts
    mount -t tmpfs -o mode=1777 tmpfs /dev/shm
    ln -s /proc/self/fd /dev/fd
    ln -s /proc/self/fd/0 /dev/stdin
    ln -s /proc/self/fd/1 /dev/stdout
    ln -s /proc/self/fd/2 /dev/stderr
    modprobe -d "$folder" -a can can-raw can-bcm can-dev vcan
    modprobe -d "$folder" -a vxcan || :
    sh "$folder/network.sh" "$channel" true
}

: >"$folder/started"
mount -t proc proc /proc
echo vcan >/proc/sys/kernel/hostname
mount -t sysfs sysfs /sys
(set_up)
[ $? -eq 0 ] || finish failed
. "$folder/command"
finish $?
