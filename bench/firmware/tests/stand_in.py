"""A stand-in for a firmware, written from the packets of Betaflight's simulator target.

`MODE` says what it does once the throttle is up; `NUMBER` is the first of its ports. The test writes them above this text.
"""
import os
import socket
import struct
import sys
import time

ON, IDLE = 1700, 0.055
MOTORS, STATE, REMOTE = range(NUMBER, NUMBER + 3)

state = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
state.bind(("127.0.0.1", STATE))
remote = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
remote.bind(("127.0.0.1", REMOTE))
remote.setblocking(False)
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def send(*numbers):
    out.sendto(struct.pack(f"<{len(numbers)}f", *numbers), ("127.0.0.1", MOTORS))


if MODE == "fails":
    sys.exit("it cannot read its settings")
if MODE == "mute":
    time.sleep(60)
# A firmware sends once of its own accord when it has started up.
send(0, 0, 0, 0)
armed = throttle = 0
while True:
    numbers = struct.unpack("<18d", state.recv(256))
    try:
        while True:
            channels = struct.unpack("<d16H", remote.recv(256))[1:]
            armed, throttle = channels[4] > ON, channels[2]
    except BlockingIOError:
        pass
    mode = MODE if throttle > 1050 else "rest"
    # Front right, rear left, front left, rear right; a right roll rate, nose-down rate and so on raise one motor each,
    # so that a test sees which number came where.
    motors = [IDLE if throttle <= 1050 else 0.5] * 4 if armed else [0] * 4
    if MODE == "never":
        motors = [0] * 4
    if mode == "signs":
        motors = [0.5 + 0.1 * number for number in (*numbers[1:4], numbers[4] / 10)]
    if mode == "late":
        time.sleep(0.05)
    if mode == "dies":
        os._exit(7)
    if mode == "silent":
        continue
    if mode == "short":
        send(*motors[:3])
    elif mode == "nan":
        send(float("nan"), *motors[:3])
    elif mode == "disarms":
        send(0, 0, 0, 0)
    else:
        send(*motors)
    if mode == "twice":
        send(*motors)
