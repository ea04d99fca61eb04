"""A ground station with MAVSDK that flies the vehicle: two points, a velocity, a hold, and commands.

    ironbird fly --trajectory mavlink --mavlink --allow-control     # in one terminal
    pip install mavsdk==4.1.0
    python examples/offboard.py                                     # in another

It exits with 1 if the vehicle does not do what `ironbird docs ground-station` says.
"""

import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityNedYaw
from mavsdk.plugins.telemetry import FlightMode, Telemetry

ADDRESS = sys.argv[1] if len(sys.argv) > 1 else "udpin://127.0.0.1:14550"


def wait(what, look, seconds=60):
    """Waits until `look` returns something."""
    until = time.monotonic() + seconds
    while not (seen := look()):
        if time.monotonic() > until:
            sys.exit(f"waited in vain for {what}")
        time.sleep(0.05)
    print(what)
    return seen


mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
mavsdk.add_any_connection(ADDRESS)
vehicle = mavsdk.first_autopilot(30.0)
if vehicle is None:
    sys.exit("no vehicle: is `ironbird fly --trajectory mavlink --mavlink --allow-control` running?")

telemetry, offboard, action = Telemetry(vehicle), Offboard(vehicle), Action(vehicle)
texts = []
telemetry.subscribe_status_text(lambda text, _: texts.append(text.text))


def is_near(north_m, east_m, down_m, yaw_deg=None):
    """Whether the vehicle is within 5 cm of a place, and turned as it should be."""
    position = telemetry.position_velocity_ned().position
    away = (position.north_m - north_m, position.east_m - east_m, position.down_m - down_m)
    turned = yaw_deg is None or abs(telemetry.attitude_euler().yaw_deg - yaw_deg) < 2
    return max(map(abs, away)) < 0.05 and turned


def is_still():
    """Whether the vehicle is at rest."""
    velocity = telemetry.position_velocity_ned().velocity
    return max(map(abs, (velocity.north_m_s, velocity.east_m_s, velocity.down_m_s))) < 0.05


wait("armed", telemetry.armed)
action.arm()
action.set_takeoff_altitude(2.5)
action.takeoff()
wait("at 2.5 m", lambda: is_near(0, 0, -2.5))

# MAVSDK repeats the newest setpoint 20 times a second. The first one comes before the mode.
offboard.set_position_ned(PositionNedYaw(2.0, 0.0, -2.0, 90.0))
offboard.start()
wait("offboard", lambda: telemetry.flight_mode() == FlightMode.OFFBOARD)
wait("at the first point", lambda: is_near(2, 0, -2, 90))
offboard.set_position_ned(PositionNedYaw(2.0, 3.0, -3.0, 0.0))
wait("at the second point", lambda: is_near(2, 3, -3, 0))
offboard.set_velocity_ned(VelocityNedYaw(-1.0, 0.0, 0.0, 0.0))
wait("flies south", lambda: telemetry.position_velocity_ned().position.north_m < 0)

# The mode hold stops the vehicle, and setpoints have no effect.
offboard.stop()
wait("hold", lambda: telemetry.flight_mode() == FlightMode.HOLD)
wait("at rest", is_still)
action.land()
wait("down", lambda: telemetry.position_velocity_ned().position.down_m > 0.15)

# A stream that stops: the plant holds the position after half a second.
offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, -1.0, 0.0))
offboard.start()
wait("climbs", lambda: telemetry.position_velocity_ned().position.down_m < -0.5)
for text in texts:
    print("  ", text)
print("done")
