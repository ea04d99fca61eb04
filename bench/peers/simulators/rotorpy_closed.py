"""RotorPy in closed loop: its Hummingbird, its SE3Control, its Lissajous, its default integrator, one `step` per tick."""

import math

import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.trajectories.lissajous_traj import TwoDLissajous
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

import closed_loop

PERIOD_S = 1e-3
(A, a), (B, b) = closed_loop.X, closed_loop.Y


def fly(ticks):
    craft, controller = Multirotor(quad_params), SE3Control(quad_params)
    curve = TwoDLissajous(A=A, B=B, a=a, b=b, height=closed_loop.HEIGHT_M)
    position, velocity, _ = closed_loop.reference(0.0)
    hover = math.sqrt(quad_params["mass"] * controller.g / (4.0 * quad_params["k_eta"]))
    state = {
        "x": np.array(position),
        "v": np.array(velocity),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(4, hover),
    }
    largest = 0.0
    for tick in range(ticks):
        t = tick * PERIOD_S
        flat = curve.update(t)
        largest = max(largest, math.dist(state["x"], flat["x"]))
        state = craft.step(state, controller.update(t, state, flat), PERIOD_S)
    return largest


flights, seconds = closed_loop.arguments()
closed_loop.report(closed_loop.one_by_one(fly), PERIOD_S, flights, seconds)
