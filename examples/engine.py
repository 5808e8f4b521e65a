"""Press a full body with a ball at 1 kHz, and print the force.

python examples/engine.py
"""

import time

import palpate as pt

SIZE, BALL = (0.06, 0.06, 0.03), 0.012  # [m]

cloud = pt.box(SIZE, spacing=0.005)
tissue = pt.materials.NeoHookean(C1=1.1e3, density=1060, poisson=0.45)
body = pt.Solid(cloud, tissue, fixed="z-", mass_damping=8)
ball = pt.tools.Contact(pt.tools.Sphere(BALL), (0.03, 0.03, SIZE[2] + BALL + 0.001))  # 1 mm above the body

with pt.Engine(pt.realtime_model(body, contact=ball)) as engine:
    for k in range(50):
        engine.set_pose((0.0, 0.0, -1.5e-4 * k))  # displacement of the ball [m]
        time.sleep(0.02)
        reading = engine.read()
        print(f"{reading.time:.2f} s  {1e3 * reading.position[2]:6.2f} mm  {reading.force[2]:.3f} N")
    print(engine.statistics().status)
