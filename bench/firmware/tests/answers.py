"""The answers of stand-ins for a firmware: right ones, and wrong ones by the mode. The test writes this above each of them."""
import os
import time


def answer(motors, mode, rate, force_x):
    """Motor commands to send; none where the mode sends nothing."""
    if mode == "signs":
        # A right roll rate, nose-down rate and so on raise one motor each, so that a test sees which number came where.
        return [0.5 + 0.1 * number for number in (*rate, force_x / 10)]
    if mode == "late":
        time.sleep(0.05)
    if mode == "dies":
        os._exit(7)
    if mode == "disarms" or MODE == "never":
        return [0.0] * 4
    if mode == "nan":
        return [float("nan"), *motors[1:]]
    return None if mode == "silent" else motors


