"""Crazyflow in closed loop: its default drone, dynamics and state controller, many worlds at once, the curve as its reference.

`default` integrates with Euler in single precision at 500 Hz, the controllers at its rates. `equal` does as much as ironbird: RK4 in
four steps per tick of 500 Hz, in double precision, every controller in every tick.
"""

import jax
import jax.numpy as jnp
import numpy as np
from crazyflow.control import Control
from crazyflow.sim import Sim
from crazyflow.sim.integration import Integrator

import closed_loop

PERIOD_S = 2e-3
flights, seconds, variant = closed_loop.arguments("FLIGHTS SECONDS default|equal")
options = {}
if variant == "equal":
    jax.config.update("jax_enable_x64", True)
    controllers = ("state", "attitude", "force_torque", "body_rate")
    options = {"integrator": Integrator.rk4, "freq": 2000, **{f"{controller}_freq": 500 for controller in controllers}}
sim = Sim(n_worlds=flights, control=Control.state, **options)
(A, a), (B, b) = closed_loop.X, closed_loop.Y


@jax.jit
def command(t):
    """The reference at a time, for each world."""
    zero = 0.0 * t
    position = [A * jnp.sin(a * t), B * jnp.sin(b * t), zero + closed_loop.HEIGHT_M]
    velocity = [A * a * jnp.cos(a * t), B * b * jnp.cos(b * t), zero]
    acceleration = [-A * a * a * jnp.sin(a * t), -B * b * b * jnp.sin(b * t), zero]
    attitude, rates = [zero, zero, zero, zero + 1], [zero] * 3
    one = jnp.stack([*position, *velocity, *acceleration, *attitude, *rates])
    return jnp.broadcast_to(one, (flights, 1, 16))


def fly(_, ticks):
    sim.reset()
    states = sim.data.states
    position, velocity, _ = closed_loop.reference(0.0)
    place = lambda like, values: jnp.broadcast_to(jnp.asarray(values, like.dtype), like.shape)
    states = states.replace(pos=place(states.pos, position), vel=place(states.vel, velocity),
                            rotor_vel=jnp.full_like(states.rotor_vel, 15000.0))
    sim.data = sim.data.replace(states=states)
    steps = sim.freq // sim.control_freq
    for i in range(max(1, round(ticks * PERIOD_S * sim.control_freq))):
        sim.state_control(command(i / sim.control_freq))
        sim.step(steps)
    end = np.asarray(sim.data.states.pos)[:, 0]
    position, _, _ = closed_loop.reference(ticks * PERIOD_S)
    return float(np.linalg.norm(end - np.array(position), axis=1).max())


closed_loop.report(fly, PERIOD_S, flights, seconds, warm_flights=flights)
