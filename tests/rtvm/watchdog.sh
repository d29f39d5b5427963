#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Inside the guest: the guard with the machine's watchdog (i6300esb, 3 s). One line of "NAME VALUE" each.
#   watchdog.sh BIN orderly|killed|disobeyed
# orderly: guarded for three times the watchdog's patience, ended by SIGTERM, and the machine must live on.
# killed: the guard ends by SIGKILL; disobeyed: it lives, but a robot is enabled that nobody has permitted.
# Then the machine must be reset: `alive_s` counts the seconds until it is.
set -u
bin=$1 case=$2
rmmod i6300esb && modprobe i6300esb heartbeat=3 || exit 1
cat > /tmp/guard.toml <<'TOML'
allow_non_rt = true
[dds]
allow_unsecured = true
[robot]
translation_mm = [120.0, -35.0, 310.0]
rotation_xyzw = [0.0, 0.7071067811865476, 0.0, 0.7071067811865476]
[watchdog]
device = "/dev/watchdog"
TOML
"$bin/holdfast-guard" --config /tmp/guard.toml 2> /tmp/guard.err &
guard=$!
tail -n +1 -f --pid=$guard /tmp/guard.err | sed -u 's/^/# /' &
until grep -q running /tmp/guard.err || ! kill -0 $guard; do sleep 0.1; done
case $case in
  orderly) sleep 9; echo "guarded_s 9"; kill -TERM $guard; wait $guard ;;
  killed) sleep 5; echo "guarded_s 5"; kill -KILL $guard; wait $guard 2> /dev/null ;;
  disobeyed)
    "$bin/holdfast-sim" robot --disobeys &
    until grep -q robot_disobeys /tmp/guard.err; do sleep 0.1; done
    echo "guarded_s 0" ;;
esac
for second in 1 2 3 4 5 6 7 8 9 10; do sleep 1; echo "alive_s $second"; done
