"""Stand-ins for ArduPilot and PX4, written from the sources that their ports name: each hovers 1 m above its start.

`FIRMWARE` is which one, `MODE` what it does once the vehicle no longer stands on the ground, NUMBER its port. The test writes them above
this text. Vectors are FRD and NED; motors are front right, rear left, front left, rear right.
"""
import json
import math
import socket
import struct
import sys

G, MASS, INERTIA, ARM, THRUST, DRAG, FULL_N = 9.8, 0.52, (0.0069, 0.0069, 0.0129), 0.205, 3.13e-5, 7.5e-7, 3.83425


class ArduPilot:
    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.1)
        self.number = 0

    def send(self, motors, number, size=40):
        channels = [round(1000 + 1000 * motor) for motor in motors] + [1500] * 12
        packet = struct.pack("<HHI16H", 18458, 400, number, *channels)
        self.socket.sendto(packet[:size], ("127.0.0.1", NUMBER))

    def state(self):
        line = self.socket.recv(2048)
        assert line.startswith(b"\n{") and line.endswith(b"}\n"), line
        state = json.loads(line)
        assert state["timestamp"] > 0
        self.number += 1
        imu = state["imu"]
        return imu["gyro"], imu["accel_body"], state["quaternion"], state["position"], state["velocity"]


class PX4:
    """Knows its attitude from its rate alone, and its place from GPS."""

    LATITUDE, LONGITUDE, HEIGHT_M, DEGREE_M = 47.397742, 8.545594, 488.0, math.radians(6378137)

    def __init__(self):
        while True:
            self.socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            if self.socket.connect_ex(("127.0.0.1", NUMBER)) == 0:
                break
            time.sleep(0.01)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.number, self.bytes = 0, b""
        self.attitude, self.position, self.velocity = (1, 0, 0, 0), (0, 0, 0), (0, 0, 0)
        self.frame(0, 50, struct.pack("<IBBBBB", 0, 2, 12, 0, 0, 3))

    def frame(self, message, extra, payload):
        body = bytes([len(payload), 0, 0, 0, 1, 1, message, 0, 0]) + payload
        crc = 0xFFFF
        for byte in body + bytes([extra]):
            byte ^= crc & 0xFF
            byte ^= byte << 4 & 0xFF
            crc = crc >> 8 ^ byte << 8 ^ byte << 3 ^ byte >> 4
        self.socket.sendall(b"\xfd" + body + struct.pack("<H", crc & 0xFFFF))

    def send(self, motors, number, size=81):
        mode = 1 + 128 * any(motors)
        payload = struct.pack("<QQ16fB", number, 1, *motors, *[0] * 12, mode)
        if number > 0 and size == 81:
            self.frame(93, 47, payload)
        elif size != 81:
            self.socket.sendall(payload[:size])

    def state(self):
        while True:
            message, payload = self.message()
            if message == 113:
                _, lat, lon, alt, _, _, _, *velocity = struct.unpack("<Qiii3H3h", payload[:32])
                north = (lat * 1e-7 - self.LATITUDE) * self.DEGREE_M
                east = (lon * 1e-7 - self.LONGITUDE) * self.DEGREE_M * math.cos(math.radians(self.LATITUDE))
                self.position, self.velocity = (north, east, self.HEIGHT_M - alt / 1e3), [it / 100 for it in velocity]
            if message == 107:
                time_us, *numbers, fields, identity = struct.unpack("<Q13fIB", payload[:65])
                assert fields & 0x1FF == 0x1FF and identity == 0
                force, rate = numbers[:3], numbers[3:6]
                self.turn(rate, (time_us - (self.number or time_us)) / 1e6)
                self.number = time_us
                return rate, force, self.attitude, self.position, self.velocity

    def message(self):
        while len(self.bytes) < 12 or len(self.bytes) < 12 + self.bytes[1]:
            more = self.socket.recv(4096)
            if not more:
                sys.exit(0)
            self.bytes += more
        length, message = self.bytes[1], int.from_bytes(self.bytes[7:10], "little")
        payload, self.bytes = self.bytes[10 : 10 + length], self.bytes[12 + length :]
        # Zeroes at the end are not sent.
        return message, payload.ljust(80, b"\0")

    def turn(self, rate, step_s):
        w, x, y, z = self.attitude
        p, q, r = (it * step_s / 2 for it in rate)
        turned = (w - x * p - y * q - z * r, x + w * p + y * r - z * q, y + w * q + z * p - x * r, z + w * r + x * q - y * p)
        self.attitude = [it / math.hypot(*turned) for it in turned]


def hover(rate, attitude, position, velocity):
    w, x, y, z = attitude
    roll, yaw = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    pitch = math.asin(max(-1, min(1, 2 * (w * y - z * x))))
    north, east, down = (max(-3, min(3, 1.5 * (to - at) - 2 * v)) for to, at, v in zip((0, 0, -1), position, velocity))
    errors = east / G - roll, -north / G - pitch, -yaw
    roll, pitch, yaw = (inertia * (60 * error - 12 * it) for inertia, error, it in zip(INERTIA, errors, rate))
    roll, pitch, yaw = roll / (math.sqrt(8) * ARM), pitch / (math.sqrt(8) * ARM), yaw * THRUST / DRAG / 4
    # Front right and rear left turn clockwise, so they turn the nose to the left.
    signs = (-1, 1, -1), (1, -1, -1), (1, 1, 1), (-1, -1, 1)
    thrusts = (MASS * (G - down) / 4 + a * roll + b * pitch + c * yaw for a, b, c in signs)
    return [max(0.05, math.sqrt(max(0, min(1, it / FULL_N)))) for it in thrusts]


if MODE == "fails":
    sys.exit("it cannot read its settings")
if MODE == "mute":
    time.sleep(60)
firmware = ArduPilot() if FIRMWARE == "ardupilot-json" else PX4()
motors = [0.0] * 4
firmware.send(motors, 0)
while True:
    try:
        rate, force, *rest = firmware.state()
    except TimeoutError:
        # Without a state the same frame goes out again.
        firmware.send(motors, firmware.number)
        continue
    mode = MODE if force[2] > -5 else "rest"
    motors = hover(rate, *rest)
    sent = answer(motors, mode, rate, force[0])
    if sent is None:
        continue
    motors = sent
    firmware.send(motors, 1 if mode == "old" else firmware.number, *([30] if mode == "short" else []))
    if mode == "twice":
        firmware.send(motors, firmware.number)
