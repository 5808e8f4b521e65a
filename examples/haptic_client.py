"""A device that feels a body which `palpate view` shows: poses in at 1 kHz; force, stiffness, trust out; latency told.

palpate view model.rom --no-browser
python examples/haptic_client.py 'http://127.0.0.1:8765/#TOKEN' 5
"""

from __future__ import annotations

import asyncio
import json
import struct
import sys
import time

import numpy as np
from websockets.asyncio.client import connect

RATE, RADIUS, DEPTH = 1000, 0.02, 0.006  # [Hz], [m], [m]


async def main(address: str, seconds: float) -> None:
    """Press and feel for some seconds, and print what it was like."""
    base, token = address.split("/#")
    options = {"subprotocols": ["palpate.v1"], "max_size": None, "compression": None}
    async with connect(base.replace("http", "ws", 1) + "/session", **options) as socket:
        await socket.send(json.dumps({"type": "hello", "protocol": 1, "token": token, "name": "dummy device"}))
        hello, geometry = json.loads(await socket.recv()), await socket.recv()
        if not hello["driver"] or not hello["tools"]:
            raise SystemExit("another viewer drives, or the body takes no tool")
        points = np.frombuffer(geometry, "<f4", 3 * hello["vertices"], 16).reshape(-1, 3)
        place = points[np.argmin(points[:, 1])] - np.array([0.0, RADIUS + 0.003, 0.0])  # before the foremost vertex
        ball = {"kind": "sphere", "radius": RADIUS, "friction": 0.2, "stiffness": 300.0, "position": place.tolist()}
        await socket.send(json.dumps({"type": "tool", **ball}))
        await socket.send(json.dumps({"type": "force", "rate": RATE}))
        sent: dict[int, float] = {}
        felt: list[np.ndarray] = []
        latencies: list[float] = []
        hand = asyncio.create_task(move(socket, place, sent))
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            message = await socket.recv()
            if isinstance(message, str):
                told = json.loads(message)
                if told["type"] == "error":
                    raise SystemExit(told["reason"])
            elif struct.unpack_from("<I", message)[0] == 4:  # frames for the eye are not acknowledged: two come
                numbers = np.frombuffer(message, "<f8", 23, 16)
                felt.append(numbers)
                if int(numbers[22]) in sent:
                    latencies.append(time.perf_counter() - sent.pop(int(numbers[22])))
        hand.cancel()
        await socket.send(json.dumps({"type": "release"}))
    force, stiffness = np.array([f[2:5] for f in felt]), felt[int(np.argmax([f[3] ** 2 for f in felt]))][8:17]
    print(f"{len(felt) / seconds:.0f} forces a second; largest {np.linalg.norm(force, axis=1).max():.3g} N")
    print(f"contact stiffness there [N/m]:\n{stiffness.reshape(3, 3).round(1)}")
    print(f"largest trust number {max(f[1] for f in felt):.2f} (above 1: not trained on)")
    low, high = 1e3 * np.percentile(latencies, [50, 95])
    print(f"from a pose to the force with it: {low:.2f} ms in the median, {high:.2f} ms at the 95th percentile")


async def move(socket, place, sent) -> None:
    """Press and let go, once a second."""
    began, number = time.perf_counter(), 0
    while True:
        now, number = time.perf_counter() - began, number + 1
        deep = (DEPTH + 0.003) * np.sin(np.pi * now) ** 2
        sent[number] = time.perf_counter()
        pose = {"type": "pose", "position": (place + np.array([0.0, deep, 0.0])).tolist(), "sequence": number}
        await socket.send(json.dumps(pose))
        await asyncio.sleep(max(0.0, began + number / RATE - time.perf_counter()))


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else 5.0))
