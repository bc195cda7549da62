#!/bin/bash
# SPDX-License-Identifier: AGPL-3.0-or-later
# Kills the service, a source's intake and the worker's service in turn, N times, while pictures
# arrive, and measures how long each is away: from the kill until its new program runs. Says how many
# of each, the slowest return, and what one start takes in this machine when nothing was killed.
number=$1 slowest=0 start=0 service=0 intake=0 worker=0 deaths=0
units=/sys/fs/cgroup/system.slice

# No process is started to look or to wait: in emulation that would cost more than what is measured.
mkfifo /run/never && exec 9<>/run/never
rest() { read -rt 0.02 -u 9; }
milliseconds() { now=$((${EPOCHREALTIME/./} / 1000)); }

# find UNIT PROGRAM: the process of the unit that runs this program, in $found; 0: none
find() {
    local pids=() pid name
    found=0
    mapfile -t pids 2>/dev/null <"$units/$1/cgroup.procs"
    for pid in "${pids[@]}"; do
        read -r name 2>/dev/null <"/proc/$pid/comm"
        [ "$name" = "$2" ] && found=$pid && return
    done
}

# wait_for_other PID UNIT PROGRAM: until it is another process
wait_for_other() {
    local end=$((SECONDS + 60))
    while [ $SECONDS -lt $end ]; do
        find "$2" "$3"
        [ "$found" != 0 ] && [ "$found" != "$1" ] && return 0
        rest
    done
    echo "$3 of $2 did not come back"
    exit 1
}

for _ in 1 2 3; do
    systemctl stop gieson.service
    milliseconds && began=$now
    systemctl start --no-block gieson.service
    wait_for_other 0 gieson.service giesond
    milliseconds
    [ $((now - began)) -gt $start ] && start=$((now - began))
done

for ((i = 0; i < number; i++)); do
    name=$(printf %03d "$i")
    cp "/srv/pictures/$name.png" /srv/scans/.new && mv /srv/scans/.new "/srv/scans/$name.png"
    with=()
    case $((i % 3)) in
    0) what=(gieson.service giesond) service=$((service + 1)) ;;
    1) what=(gieson.service gieson-intake) intake=$((intake + 1)) ;;
    2) what=(gieson-worker.service giesond) worker=$((worker + 1)) ;;
    esac
    # Its work dies with it, but not once more than the queue bears with one job.
    if [ $((i % 6)) = 5 ] && [ $deaths -lt 4 ]; then
        find gieson-worker.service gieson-work
        [ "$found" != 0 ] && with=("$found") && deaths=$((deaths + 1))
    fi
    wait_for_other 0 "${what[@]}"
    pid=$found
    milliseconds && began=$now
    # In this order: the worker is to die, not to hear that its service did.
    kill -9 "${with[@]}" "$pid"
    wait_for_other "$pid" "${what[@]}"
    milliseconds
    took=$((now - began))
    echo "${what[*]}: $took ms" >>/run/kills.log
    [ $took -gt $slowest ] && slowest=$took
done
echo "$service kills of the service, $intake of the intake, $worker of the worker, $deaths of its work too:" \
    "slowest return $slowest ms, a start takes $start ms"
