#!/bin/bash
# run.sh ROOT SYSTEM.json [COMMAND...]: start a ROS 1 master and the built software, run a command
# beside them (without one: until interrupted), and end both.
set -u
root=$(cd "$1" && pwd)
system=$2
shift 2
build=$root/build
export ROS_MASTER_URI=${ROS_MASTER_URI:-http://127.0.0.1:11311} ROS_IP=${ROS_IP:-127.0.0.1}
messages=$root/messages/python:/usr/lib/python3/dist-packages
export PYTHONPATH=$messages${PYTHONPATH:+:$PYTHONPATH}
logs=$(mktemp -d)
port=${ROS_MASTER_URI##*:}
/usr/bin/python3 /usr/bin/rosmaster --core -p "${port%/}" >"$logs/master" 2>&1 &
master=$!
robot=
trap 'kill $robot $master 2>/dev/null' EXIT
sleep 3
libraries=$build/cisst/lib:$build/kit:$build/bridge:$build/cisst/cisstReflexxesTypeII/lib
file=$root/src/sawIntuitiveResearchKit/share/system/$system
(
    cd "$logs" || exit
    LD_LIBRARY_PATH=$libraries exec "$build/bridge/dvrk" "$file" "${PERIOD:-0.005}" 0.02
) >"$logs/robot" 2>&1 &
robot=$!
for _ in $(seq 120); do
    grep -q READY "$logs/robot" && break
    kill -0 $robot 2>/dev/null || { tail -3 "$logs/robot"; exit 1; }
    sleep 0.5
done
sleep 3
if [ $# -gt 0 ]; then "$@"; else wait $robot; fi
