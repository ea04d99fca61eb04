"""A stand-in for a firmware, written from the packets of Betaflight's simulator target.

`MODE` says what it does once the throttle is up; `NUMBER` is the first of its ports. The test writes them above this text.
"""
import socket
import struct
import sys

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
armed = throttle = stamp = 0
while True:
    numbers = struct.unpack("<18d", state.recv(256))
    try:
        while True:
            channels = struct.unpack("<d16H", remote.recv(256))[1:]
            armed, throttle = channels[4] > ON, channels[2]
    except BlockingIOError:
        pass
    mode = MODE if throttle > 1050 else "rest"
    # Front right, rear left, front left, rear right.
    motors = [IDLE if throttle <= 1050 else 0.5] * 4 if armed else [0] * 4
    motors = answer(motors, mode, numbers[1:4], numbers[4])
    if motors is None:
        continue
    if mode == "steps":
        motors = [20 * (numbers[0] - stamp)] * 4
    stamp = numbers[0]
    send(*motors[: 3 if mode == "short" else 4])
    if mode == "twice":
        send(*motors)
