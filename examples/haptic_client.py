"""A dummy haptic device in a closed loop at 1 kHz with a session of `palpate view`; prints rate and latency.

    palpate view model.rom --no-browser
    python examples/haptic_client.py 'http://127.0.0.1:8765/#TOKEN' 5

The device is a mass between the body, whose newest force acts on it, and a user, modelled by a spring that presses and
releases once a second.
"""

from __future__ import annotations

import asyncio
import json
import struct
import sys
from collections import deque
from time import perf_counter

import numpy as np
from websockets.asyncio.client import connect

RATE, RADIUS, DEPTH, GAP = 1000, 0.02, 0.006, 0.003  # [Hz], [m], [m], [m]
MAX_AGE = 0.02  # [s] of a force; an older one counts as zero: the connection is gone, or the session does not run
RAMP = 0.2  # [s] in which the force comes back after that
MASS, USER_STIFFNESS, DAMPING = 0.1, 300.0, 8.0  # [kg], [N/m], [N s/m]


async def main(address: str, seconds: float) -> None:
    """Press for a duration [s], and print rate and latency."""
    base, token = address.split("/#")
    options = {"subprotocols": ["palpate.v2"], "max_size": None, "compression": None}
    async with connect(base.replace("http", "ws", 1) + "/session", **options) as socket:
        await socket.send(json.dumps({"type": "hello", "protocol": 2, "token": token, "name": "dummy device"}))
        hello, geometry = json.loads(await socket.recv()), await socket.recv()
        if not hello["driver"] or not hello["tools"]:
            raise SystemExit("this client must be the driver of a body with tool contact; close other viewers")
        points = np.frombuffer(geometry, "<f4", 3 * hello["vertices"], 16).reshape(-1, 3)
        home = points[np.argmin(points[:, 1])] - np.array([0.0, RADIUS + GAP, 0.0])  # in front of the foremost vertex
        ball = {"kind": "sphere", "radius": RADIUS, "friction": 0.2, "stiffness": None, "position": home.tolist()}
        await socket.send(json.dumps({"type": "tool", **ball}))
        await socket.send(json.dumps({"type": "force", "rate": RATE}))
        sent, forces, latencies, arrivals = deque(), deque([np.zeros(23)]), [], deque([0.0], maxlen=1)
        device = asyncio.create_task(move(socket, home, sent, forces, arrivals, seconds))
        while not device.done():
            message = await socket.recv()
            if isinstance(message, str):
                if (answer := json.loads(message))["type"] == "error":
                    raise SystemExit(answer["reason"])
            elif struct.unpack_from("<I", message)[0] == 4:  # state frames are not acknowledged, so only two arrive
                forces.append(np.frombuffer(message, "<f8", 23, 16))
                arrivals.append(perf_counter())
                while sent and sent[0][0] <= forces[-1][22]:  # the force includes this pose
                    latencies.append(perf_counter() - sent.popleft()[1])
    force, stiffness = np.array([f[2:5] for f in forces]), max(forces, key=lambda f: f[2:5] @ f[2:5])[8:17]
    print(
        f"{len(forces) / seconds:.0f} forces a second, of {len({f[20] for f in forces}) / seconds:.0f} periods; "
        f"largest {np.linalg.norm(force, axis=1).max():.3g} N, {len(latencies) / seconds:.0f} poses a second"
    )
    print(f"contact stiffness there [N/m]:\n{stiffness.reshape(3, 3).round(1)}")
    print(f"largest error indicator {max(f[1] for f in forces):.2f} (above 1: not trained on)")
    middle, high, largest = 1e3 * np.percentile(latencies, [50, 95, 100])
    print(
        f"latency from a pose to its force: median {middle:.2f} ms, 95th percentile {high:.2f} ms, "
        f"maximum {largest:.1f} ms"
    )


async def move(socket, home: np.ndarray, sent: deque, forces: deque, arrivals: deque, seconds: float) -> None:
    """Simulate the device: one step of its motion and one pose every millisecond."""
    place, speed, began, number, share = home.copy(), np.zeros(3), perf_counter(), 0, 0.0
    while (now := perf_counter() - began) < seconds:
        number += 1
        goal = home + np.array([0.0, (DEPTH + GAP) * np.sin(np.pi * now) ** 2, 0.0])
        fresh = forces[-1][21] == 1 and perf_counter() - arrivals[-1] < MAX_AGE  # of a session that runs
        share = min(1.0, share + 1 / (RATE * RAMP)) if fresh else 0.0
        force = share * forces[-1][2:5]
        speed += (USER_STIFFNESS * (goal - place) - DAMPING * speed + force) / MASS / RATE
        place = place + speed / RATE
        sent.append((number, perf_counter()))
        await socket.send(json.dumps({"type": "pose", "position": place.tolist(), "sequence": number}))
        await asyncio.sleep(max(0.0, began + number / RATE - perf_counter()))


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else 5.0))
