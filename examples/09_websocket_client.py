"""Move an arm from another program, through the WebSocket that `trocar sim` serves.

Give the address that `trocar sim` printed; without one, a simulator is started for this example.

One sees: the arm's state, the yaw joint on its way from 0 to 0.3 rad, and that it has arrived.
"""

import json
import subprocess
import sys

from websockets.sync.client import connect
from websockets.sync.connection import Connection

GOAL = [0.3, 0.0, 0.12, 0.0, 0.0, 0.0]  # yaw, pitch [rad], insertion [m], roll, wrist [rad]


def main() -> None:
    if len(sys.argv) > 1:
        move(sys.argv[1])
        return
    words = ["sim", "--rig", "psm", "--no-page", "--websocket-port", "0"]
    command = [sys.executable, "-m", "trocar", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulator:
        try:
            for line in simulator.stdout or ():
                move(line.split()[0])
                break
        finally:
            simulator.terminate()


def move(address: str) -> None:
    """Move the yaw joint of PSM1 and follow it until the arm is not busy any more."""
    with connect(address) as socket:
        say(socket, "subscribe", topic="/PSM1/operating_state")
        say(socket, "subscribe", topic="/PSM1/measured_js", throttle_rate=100)
        say(socket, "publish", topic="/PSM1/move_jp", msg={"position": GOAL})
        was_busy = False
        for text in socket:
            heard = json.loads(text)
            if heard.get("topic") == "/PSM1/measured_js":
                print(f"yaw {heard['msg']['position'][0]:6.3f} rad")
            elif heard.get("topic") == "/PSM1/operating_state":
                busy = heard["msg"]["is_busy"]
                print(heard["msg"]["state"], "and busy" if busy else "and not busy")
                if was_busy and not busy:
                    print("arrived")
                    return
                was_busy = busy


def say(socket: Connection, op: str, **fields: object) -> None:
    """Send one request of the rosbridge protocol."""
    socket.send(json.dumps({"op": op, **fields}))


main()
