"""Connects as QGroundControl does, with pymavlink, to a vehicle that only observes; and tries what it may not.

    python pymavlink_station.py tcp:127.0.0.1:5760
"""

import socket
import sys
import time

from pymavlink import mavutil
from pymavlink.dialects.v20 import all as mavlink

PARAMETERS = 33
# Not in the dialects of pymavlink.
COMPONENT_METADATA = 397


station = mavutil.mavlink_connection(sys.argv[1], source_system=255, source_component=190, dialect="all")
unread = []


def receive(kind, is_it=lambda message: True, seconds=30):
    """The next message of a kind; texts and answers may come in any order."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        for place, message in enumerate(unread):
            if message.get_type() == kind and is_it(message):
                return unread.pop(place)
        message = station.recv_match(blocking=True, timeout=1)
        if message is not None and message.get_type() != "BAD_DATA":
            unread.append(message)
    sys.exit(f"waited in vain for {kind}")


def command(number, *parameters, target=1):
    padded = [*parameters, *[0] * (7 - len(parameters))]
    station.mav.command_long_send(target, 1, number, 0, *padded)


def result(number):
    ack = receive("COMMAND_ACK", lambda message: message.command == number)
    return mavlink.enums["MAV_RESULT"][ack.result].name.removeprefix("MAV_RESULT_")


def text(words):
    """Waits for a text, which may come in parts."""
    parts = ""
    while words not in parts:
        parts += receive("STATUSTEXT").text
    return words


heartbeat = receive("HEARTBEAT")
assert (heartbeat.type, heartbeat.autopilot) == (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC)
assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (1, 1)

# The connect sequence: version, metadata, modes, parameters, mission.
command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
assert result(mavlink.MAV_CMD_REQUEST_MESSAGE) == "ACCEPTED"
assert receive("AUTOPILOT_VERSION").capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
command(mavlink.MAV_CMD_REQUEST_MESSAGE, COMPONENT_METADATA)
assert result(mavlink.MAV_CMD_REQUEST_MESSAGE) == "UNSUPPORTED"
command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AVAILABLE_MODES)
assert result(mavlink.MAV_CMD_REQUEST_MESSAGE) == "ACCEPTED"
assert receive("AVAILABLE_MODES").mode_name == "lissajous"
station.mav.param_request_list_send(1, 1)
parameters = [receive("PARAM_VALUE") for _ in range(PARAMETERS)]
assert sorted(it.param_index for it in parameters) == list(range(PARAMETERS))
values = {it.param_id: it.param_value for it in parameters}
assert len(values) == PARAMETERS and abs(values["MASS"] - 0.52) < 1e-6 and values["SYS_FAILURE_EN"] == 0
station.mav.mission_request_list_send(1, 1, mavlink.MAV_MISSION_TYPE_MISSION)
assert receive("MISSION_COUNT").count == 0
for kind in (
    "SYS_STATUS",
    "EXTENDED_SYS_STATE",
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "POSITION_TARGET_LOCAL_NED",
    "GLOBAL_POSITION_INT",
    "HOME_POSITION",
    "GPS_GLOBAL_ORIGIN",
    "VFR_HUD",
    "SERVO_OUTPUT_RAW",
    "SYSTEM_TIME",
):
    receive(kind)
print("connected")

# What is not done is refused with its result and the reason.
for number, expected in (
    (mavlink.MAV_CMD_NAV_TAKEOFF, "DENIED"),
    (mavlink.MAV_CMD_NAV_LAND, "DENIED"),
    (mavlink.MAV_CMD_DO_REPOSITION, "DENIED"),
    (mavlink.MAV_CMD_PREFLIGHT_CALIBRATION, "UNSUPPORTED"),
):
    command(number)
    assert result(number) == expected, number
text("is fixed: `ironbird fly --trajectory`")
station.mav.set_position_target_local_ned_send(0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, 0, 0, 0, -2, *[0] * 8)
text("setpoints")
station.mav.param_set_send(1, 1, b"MASS", 0.6, mavlink.MAV_PARAM_TYPE_REAL32)
assert receive("PARAM_ERROR").error == mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED
assert abs(receive("PARAM_VALUE").param_value - 0.52) < 1e-6
text("--allow-control")
command(mavlink.MAV_CMD_INJECT_FAILURE, mavlink.FAILURE_UNIT_SENSOR_GPS, mavlink.FAILURE_TYPE_OFF)
assert result(mavlink.MAV_CMD_INJECT_FAILURE) == "DENIED"
print("refused")

# Another vehicle is not this one, and a second station gets no vehicle.
command(mavlink.MAV_CMD_NAV_LAND, target=2)
command(mavlink.MAV_CMD_NAV_TAKEOFF)
assert result(mavlink.MAV_CMD_NAV_TAKEOFF) == "DENIED"
assert not [it for it in unread if it.get_type() == "COMMAND_ACK"]
_, host, port = sys.argv[1].split(":")
with socket.create_connection((host, port), timeout=30) as second:
    assert second.recv(1) == b""
print("alone")

# A signature is refused, and said so.
station.setup_signing(b"\1" * 32, sign_outgoing=True, allow_unsigned_callback=lambda *_: True)
station.mav.param_request_list_send(1, 1)
text("signed frames are ignored")
assert not [it for it in unread if it.get_type() == "PARAM_VALUE"]
print("unsigned")
