"""A ground station with MAVSDK: it watches a flight, changes a parameter and injects failures.

    ironbird fly --mavlink --allow-control          # in one terminal
    pip install mavsdk==4.1.0
    python examples/ground_station.py               # in another

It exits with 1 if the vehicle does not do what `ironbird docs ground-station` says.
"""

import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.failure import Failure, FailureError, FailureType, FailureUnit
from mavsdk.plugins.param import Param, ParamError
from mavsdk.plugins.telemetry import Telemetry

ADDRESS = sys.argv[1] if len(sys.argv) > 1 else "udpin://127.0.0.1:14550"


def wait(what, look, seconds=30):
    """Waits until `look` returns something."""
    until = time.monotonic() + seconds
    while not (seen := look()):
        if time.monotonic() > until:
            sys.exit(f"waited in vain for {what}")
        time.sleep(0.05)
    print(f"{what}: {seen}")
    return seen


mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
mavsdk.add_any_connection(ADDRESS)
vehicle = mavsdk.first_autopilot(30.0)
if vehicle is None:
    sys.exit("no vehicle: is `ironbird fly --mavlink` running?")

telemetry, param, failure = Telemetry(vehicle), Param(vehicle), Failure(vehicle)
texts = []
telemetry.subscribe_status_text(lambda text, _: texts.append(text.text))

# Telemetry: the vehicle has taken off and climbs; z points down.
wait("in the air", telemetry.in_air)
wait("armed", telemetry.armed)
wait("global position ok", lambda: telemetry.health().is_global_position_ok)
wait("home", lambda: telemetry.health().is_home_position_ok and telemetry.home())
wait("climbs", lambda: telemetry.position_velocity_ned().position.down_m < -0.2)

# Parameters: single precision, the value in force is acknowledged.
print("mass:", param.get_param_float("MASS"))
param.set_param_float("ROT_DRAG", 0.315)
assert abs(param.get_param_float("ROT_DRAG") - 0.315) < 1e-6
wait("its event", lambda: [text for text in texts if "rotational_drag_nm_s" in text])
try:
    param.set_param_float("MASS", 99.0)
    sys.exit("a mass of 99 kg was accepted")
except ParamError as refused:
    print("refused:", refused)
wait("the reason", lambda: [text for text in texts if "out of range" in text])
assert abs(param.get_param_float("MASS") - 0.52) < 1e-6

# Failures: a fifth of the positions is lost, and rotor commands are late, until all is well again.
failure.inject(FailureUnit.SENSOR_GPS, FailureType.INTERMITTENT, 0)
wait("the fault", lambda: [text for text in texts if "outer.state.drop=0.2" in text])
failure.inject(FailureUnit.SENSOR_GPS, FailureType.OK, 0)
failure.inject(FailureUnit.SYSTEM_SERVO, FailureType.DELAYED, 0)
failure.inject(FailureUnit.SYSTEM_SERVO, FailureType.OK, 0)
try:
    failure.inject(FailureUnit.SYSTEM_BATTERY, FailureType.OFF, 0)
    sys.exit("there is a battery")
except FailureError as refused:
    print("refused:", refused)

for text in texts:
    print("  ", text)
print("done")
