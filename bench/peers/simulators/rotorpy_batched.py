"""RotorPy's batched mode on torch: its Hummingbird, SE3 controller and Lissajous curve, RK4, one processor."""

import math

import numpy as np
import torch
from rotorpy.controllers.quadrotor_control import BatchedSE3Control
from rotorpy.trajectories.lissajous_traj import BatchedTwoDLissajous
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams

import closed_loop

PERIOD_S = 2e-3
(A, a), (B, b) = closed_loop.X, closed_loop.Y
DEVICE = torch.device("cpu")
torch.set_num_threads(1)


def fly(flights, ticks):
    each = lambda *values: torch.tensor(values, dtype=torch.double).repeat(flights, 1)
    every = lambda value: np.full(flights, value)
    position, velocity, _ = closed_loop.reference(0.0)
    hover = math.sqrt(quad_params["mass"] * 9.81 / (4.0 * quad_params["k_eta"]))
    state = {"x": each(*position), "v": each(*velocity), "q": each(0, 0, 0, 1), "w": each(0, 0, 0), "wind": each(0, 0, 0),
             "rotor_speeds": each(hover, hover, hover, hover)}
    params = BatchedMultirotorParams([quad_params] * flights, flights, DEVICE)
    craft = BatchedMultirotor(params, flights, state, DEVICE, integrator="rk4")
    controller = BatchedSE3Control(params, flights, DEVICE)
    curve = BatchedTwoDLissajous(every(A), every(B), every(a), every(b), every(0.0), every(0.0), every(0.0), every(closed_loop.HEIGHT_M),
                                 [False] * flights)
    for tick in range(ticks):
        t = tick * PERIOD_S
        flat = curve.update(torch.full((flights,), t, dtype=torch.double))
        state = craft.step(state, controller.update(every(t), state, flat), PERIOD_S)
    position, _, _ = closed_loop.reference(ticks * PERIOD_S)
    return float(torch.linalg.vector_norm(state["x"] - torch.tensor(position), dim=1).max())


flights, seconds = closed_loop.arguments()
closed_loop.report(fly, PERIOD_S, flights, seconds)
