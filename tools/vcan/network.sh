#!/bin/sh
# network.sh CHANNEL COMMAND...: bring up loopback and the vcan CHANNEL in an empty network, run the command.
set -e
channel=$1
shift
ip link set lo up multicast on
ip route add 224.0.0.0/4 dev lo # without it a process cannot join a multicast group
ip link add dev "$channel" type vcan
ip link set "$channel" up
exec "$@"
