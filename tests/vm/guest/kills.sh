#!/bin/bash
# SPDX-License-Identifier: AGPL-3.0-or-later
# Kills the service, a source's intake and the worker in turn, N times, while pictures arrive, and
# measures how long each is away. Says how many of each and the slowest return.
number=$1 slowest=0 service=0 intake=0 worker=0

main_pid() { systemctl show -P MainPID "$1"; }
intake_pid() { pgrep -o -x gieson-intake; }
milliseconds() { date +%s%3N; }

# wait_for_other PID COMMAND...: until the command names a process that is another one
wait_for_other() {
    local old=$1 new
    shift
    for _ in $(seq 600); do
        new=$("$@")
        if [ -n "$new" ] && [ "$new" != 0 ] && [ "$new" != "$old" ]; then return 0; fi
        sleep 0.05
    done
    return 1
}

for ((i = 0; i < number; i++)); do
    cp "/srv/pictures/$(printf %03d "$i").png" /srv/scans/.new && mv /srv/scans/.new "/srv/scans/$(printf %03d "$i").png"
    case $((i % 3)) in
    0) what="main_pid gieson.service"; service=$((service + 1)) ;;
    1) what=intake_pid; intake=$((intake + 1)) ;;
    2) what="main_pid gieson-worker.service"; worker=$((worker + 1)) ;;
    esac
    pid=$($what)
    if [ -z "$pid" ] || [ "$pid" = 0 ]; then
        wait_for_other 0 $what || { echo "nothing to kill: $what"; exit 1; }
        pid=$($what)
    fi
    began=$(milliseconds)
    kill -9 "$pid"
    # Its work dies with it: a job that is redone, or a worker that is waited for.
    [ $((i % 6)) = 5 ] && pkill -9 -x gieson-work
    wait_for_other "$pid" $what || { echo "$what did not come back"; exit 1; }
    took=$(($(milliseconds) - began))
    [ "$took" -gt "$slowest" ] && slowest=$took
done
echo "$service kills of the service, $intake of the intake, $worker of the worker: slowest $slowest ms"
