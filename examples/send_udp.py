"""A sensor on the network in ten lines: turns about the vertical, 60 times a second.

Receive it with:
poser live --source udp:9000 --calibration bones --sensors head --method imuposer --sink viewer
Run: python examples/send_udp.py [--port 9000] [--seconds 10]
"""

import argparse
import json
import math
import socket
import time

parser = argparse.ArgumentParser()
parser.add_argument("--port", type=int, default=9000)
parser.add_argument("--seconds", type=float, default=10.0)
args = parser.parse_args()

# q: w, x, y, z of the sensor in a y-up world; a: m/s^2 in that world, gravity removed; t: own clock.
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
    for seq in range(round(60 * args.seconds)):
        half = 0.25 * math.sin(seq / 30)
        q, a = [math.cos(half), 0, math.sin(half), 0], [0, 0, 0]
        message = {"device": "head", "t": time.monotonic(), "seq": seq, "q": q, "a": a}
        udp.sendto(json.dumps(message).encode(), ("127.0.0.1", args.port))
        time.sleep(1 / 60)
print(f"sent {round(60 * args.seconds)} messages to port {args.port}")
