#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Inside the guest: what rtvm.py wants to know, one line of "NAME JSON" each.
#   campaign.sh BIN QUIET_CYCLES LOADED_CYCLES MUTANT_CYCLES
# Zero cycles leave a part out; without mutants there is no CAN either. The load is hackbench in bursts with pauses between them.
set -u
bin=$1 quiet=$2 loaded=$3 mutant=$4
echo -1 > /proc/sys/kernel/sched_rt_runtime_us  # as docs/rtvm.md tells the person who sets up a robot PC

report() {  # NAME ARGUMENT...: the probe's line under a name; a probe that died has none
  local name=$1 line
  shift
  line=$("$bin/holdfast-rtvm-loop" "$@" 2> "/tmp/$name.err")
  echo "$name ${line:-{\"failures\":[\"died\"]\}}"
  [ -n "$line" ] || sed 's/^/# /' "/tmp/$name.err"
}

bursts() {
  while :; do
    hackbench -g 2 -f 5 -l 5 > /dev/null
    sleep 0.1
  done
}

echo "kernel \"$(uname -v) $(uname -r)\""
floor=$(cyclictest -q -m -t1 -p80 -i1000 -l 2000 | sed -n 's/.*Max: *\([0-9]*\).*/\1/p')
echo "floor_us_max ${floor:-null}"
[ "$quiet" = 0 ] || report quiet --cycles "$quiet"
if [ "$loaded" != 0 ]; then
  bursts &
  report loaded --cycles "$loaded"
  kill $!
  wait
fi
if [ "$mutant" != 0 ]; then
  for name in malloc page_touch mutex printf grid_drift; do
    report "mutant_$name" --cycles "$mutant" --mutant "$name"
  done
  for bus in can0 can1; do ip link set "$bus" up type can bitrate 1000000 restart-ms 0; done
  echo "can_vcan $("$bin/holdfast-rtvm-can" vcan0 vcan0 classic)"
  echo "can_vcan_fd $("$bin/holdfast-rtvm-can" vcan0 vcan0 fd)"
  echo "can_sja1000 $("$bin/holdfast-rtvm-can" can0 can1 classic)"
fi
