"""Types commands into MAVProxy's console, each when it has answered the one before, and prints what it says.

    python mavproxy_console.py udpin:127.0.0.1:14550
"""

import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

# What is typed, and what MAVProxy says then.
DIALOGUE = (
    (None, "Received 33 parameters"),
    ("param show MASS", "MASS             0.5199"),
    ("param set ROT_DRAG 0.2", "rotational_drag_nm_s 0.105 -> 0.2"),
    ("param show ROT_DRAG", "ROT_DRAG         0.2000"),
    ("param set MASS 99", "mass_kg = 99 is out of range: allowed are 0.05 to 5.0 kg"),
    ("status HEARTBEAT", "HEARTBEAT {type : 2, autopilot : 0"),
    ("mode AUTO", "DO_SET_MODE: DENIED"),
    ("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED"),
)

with tempfile.TemporaryDirectory() as directory:
    mavproxy = subprocess.Popen(
        [sys.executable, Path(sys.executable).with_name("mavproxy.py"), f"--master={sys.argv[1]}"]
        + [f"--state-basedir={directory}"],
        cwd=directory,
        env={"HOME": directory, "PYTHONUNBUFFERED": "1"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    said = []
    threading.Thread(target=lambda: said.extend(iter(lambda: mavproxy.stdout.read(1), "")), daemon=True).start()
    try:
        for typed, answer in DIALOGUE:
            begin = len(said)
            if typed:
                mavproxy.stdin.write(f"{typed}\n")
                mavproxy.stdin.flush()
            until = time.monotonic() + 60
            while answer not in "".join(said[begin:]):
                if time.monotonic() > until or mavproxy.poll() is not None:
                    sys.exit(f"{typed}: waited in vain for `{answer}`:\n{''.join(said)}")
                time.sleep(0.05)
            print(f"{typed}: {answer}")
    finally:
        mavproxy.kill()
        mavproxy.wait()
