"""Vectors for the laws besides the paper's, from their formulas, in numpy.

Nothing here is shared with the Rust laws, and the ways differ where they can: rotations are matrices, never
quaternions; derivatives come from Taylor arithmetic; the low-pass is a state space under the bilinear transform.
Run by hand: `python3 controller/tests/vectors/laws.py` writes laws.json beside itself.
"""

import json
import pathlib

import numpy as np

CASES, TICKS = 50, 6
E3 = np.array([0.0, 0.0, 1.0])
RNG = np.random.default_rng(20161005)


class Jet:
    """A scalar with its first and second derivative by time."""

    def __init__(self, value, d=0.0, dd=0.0):
        self.value, self.d, self.dd = value, d, dd

    def of(self, f, df, ddf):
        return Jet(f, df * self.d, ddf * self.d**2 + df * self.dd)

    def __add__(self, other):
        other = other if isinstance(other, Jet) else Jet(other)
        return Jet(self.value + other.value, self.d + other.d, self.dd + other.dd)

    def __mul__(self, other):
        other = other if isinstance(other, Jet) else Jet(other)
        return Jet(
            self.value * other.value,
            self.value * other.d + self.d * other.value,
            self.value * other.dd + 2 * self.d * other.d + self.dd * other.value,
        )

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self):
        return self * -1.0

    def __sub__(self, other):
        return self + -1.0 * other

    def inverse(self):
        x = self.value
        return self.of(1 / x, -1 / x**2, 2 / x**3)

    def sqrt(self):
        x = self.value
        return self.of(x**0.5, 0.5 * x**-0.5, -0.25 * x**-1.5)

    def sin(self):
        return self.of(np.sin(self.value), np.cos(self.value), -np.sin(self.value))

    def cos(self):
        return self.of(np.cos(self.value), -np.sin(self.value), -np.cos(self.value))

    def asin(self):
        x = self.value
        root = (1 - x * x) ** 0.5
        return self.of(np.arcsin(x), 1 / root, x / root**3)

    def atan(self):
        x = self.value
        return self.of(np.arctan(x), 1 / (1 + x * x), -2 * x / (1 + x * x) ** 2)


def jets(a, da, dda):
    return [Jet(*row) for row in zip(a, da, dda)]


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def direction(a):
    per_norm = dot(a, a).sqrt().inverse()
    return [x * per_norm for x in a]


def skew(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def vee(m):
    return 0.5 * np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])


def about(axis, angle):
    s = skew(axis)
    return np.eye(3) + np.sin(angle) * s + (1 - np.cos(angle)) * s @ s


def euler(eta):
    return about(E3, eta[2]) @ about(np.eye(3)[1], eta[1]) @ about(np.eye(3)[0], eta[0])


def of_quaternion(q):
    s = skew(q[1:])
    return np.eye(3) + 2 * q[0] * s + 2 * s @ s


def twice_half_angle_sine(r):
    """2 sin(angle/2) along the axis of a rotation of less than pi."""
    v = vee(r)
    sine, cosine = np.linalg.norm(v), (np.trace(r) - 1) / 2
    return 2 * np.sin(np.arctan2(sine, cosine) / 2) * v / sine


def allocation(frame):
    c, kappa = frame["arm_length_m"] / 2**0.5, frame["drag_factor_nm_s2"] / frame["thrust_coefficient_n_s2"]
    signs = np.array([[1, 1, 1, 1], [1, -1, -1, 1], [1, 1, -1, -1], [1, -1, 1, -1]])
    return np.diag([1, c, c, kappa]) @ signs


def inertia(frame):
    return np.diag([frame[f"inertia_{axis}_kg_m2"] for axis in "xyz"])


class LowPass:
    """w^2/(s^2 + 2 zeta w s + w^2) as a state space, bilinear, prewarped at w."""

    def __init__(self, w, zeta, period):
        h = np.tan(w * period / 2) / w
        a, b = np.array([[0, 1], [-w * w, -2 * zeta * w]]), np.array([[0], [w * w]])
        self.left = np.linalg.inv(np.eye(2) - h * a)
        self.right, self.b = np.eye(2) + h * a, h * b
        self.forget()

    def take(self, x):
        x = np.asarray(x)[None, :]
        self.state = self.left @ (self.right @ self.state + self.b @ (x + self.input))
        self.input = x
        self.output = self.state[0]

    def forget(self):
        self.state, self.input, self.output = np.zeros((2, 3)), np.zeros((1, 3)), np.zeros(3)


def limit(a, s, g):
    z = min(max(a[2], s["acceleration_z_min_g"] * g), s["acceleration_z_max_g"] * g)
    level, allowed = np.hypot(a[0], a[1]), z * np.tan(s["tilt_max_rad"])
    scale = allowed / level if level > allowed else 1.0
    return np.array([scale * a[0], scale * a[1], z]), bool(z != a[2] or level > allowed)


def of_reference(r):
    return [np.array(r[key]) for key in
            ("position_w_m", "velocity_w_m_s", "acceleration_w_m_s2", "jerk_w_m_s3", "snap_w_m_s4")]


class Estimating:
    """Outer law: (9)-(16) of the paper with estimates of thrust scale and drag."""

    def __init__(self, frame, s, period):
        self.frame, self.s, self.period = frame, s, period
        self.lam, self.sig = 1.0, frame["translational_drag_kg_s"] / frame["mass_kg"]
        self.last = None

    def tick(self, tick, measured_tick, x, wanted, ref):
        f, s, period = self.frame, self.s, self.period
        m, g, k = f["mass_kg"], f["gravity_m_s2"], f["thrust_coefficient_n_s2"]
        v, axis = np.array(x["velocity_w_m_s"]), euler(x["attitude_rad"]) @ E3
        if self.last is not None and self.last[0] == tick - 1:
            _, v_, axis_ = self.last
            p1 = axis_ * k * np.sum(x["rotor_speed_squared_mean_rad2_s2"]) / m
            p2 = -v_
            z = v - v_ - period * (-g * E3 + self.lam * p1 + self.sig * p2)
            g_l, g_s = s["thrust_scale_gain_s3_m2"], s["drag_gain_s_m2"]
            d = 1 + period * (g_l * p1 @ p1 + g_s * p2 @ p2)
            self.lam = min(max(self.lam + g_l * p1 @ z / d, 0.4), 2.0)
            self.sig = min(max(self.sig + g_s * p2 @ z / d, 0.0), 10.0)
        self.last = (tick, v, axis)
        p_d, v_d, a_d, j_d, s_d = of_reference(ref)
        u = a_d + s["velocity_1_s"] * (v_d - v) + s["position_1_s2"] * (p_d - np.array(x["position_w_m"]))
        a, limited = limit(u + g * E3 + self.sig * v, s, g)
        yaw = Jet(ref["yaw_rad"], ref["yaw_rate_rad_s"], ref["yaw_acceleration_rad_s2"])
        phi, theta = tilt(jets(a, 0 * a, 0 * a), Jet(yaw.value))
        phi_r, theta_r = tilt(jets(a_d + g * E3 + self.sig * v_d, j_d + self.sig * a_d, s_d + self.sig * j_d), yaw)
        on = 0.0 if limited else 1.0
        low, high = [4 * k * f[f"rotor_{end}_rad_s"] ** 2 for end in ("min", "max")]
        return {
            "thrust_n": min(max(m / self.lam * a @ axis, low), high),
            "attitude_rad": [phi.value, theta.value, yaw.value],
            "attitude_rate_rad_s": [on * phi_r.d, on * theta_r.d, yaw.d],
            "attitude_acceleration_rad_s2": [on * phi_r.dd, on * theta_r.dd, yaw.dd],
            "limited": limited,
            "telemetry": [self.lam, m / self.lam, self.sig],
        }


def tilt(a, yaw):
    """Roll and pitch with derivatives whose z axis is along a: a seen from the heading."""
    cos, sin = yaw.cos(), yaw.sin()
    ahead, left = a[0] * cos + a[1] * sin, a[1] * cos - a[0] * sin
    norm = dot(a, a).sqrt()
    return (-left * norm.inverse()).asin(), (ahead * a[2].inverse()).atan()


class Geometric:
    """Lee, Leok, McClamroch 2010, z up, with the drags."""

    def __init__(self, frame, s, period):
        self.frame, self.s = frame, s
        self.f = frame["mass_kg"] * frame["gravity_m_s2"]
        self.shown = [0.0] * 6

    def tick(self, tick, measured_tick, state, wanted, ref):
        if measured_tick != tick:
            return {"thrust_n": self.f, "torque_b_nm": [0.0] * 3, "telemetry": self.shown}
        frame, s = self.frame, self.s
        m, g, drag = frame["mass_kg"], frame["gravity_m_s2"], frame["translational_drag_kg_s"]
        k_x, k_v = m * s["position_1_s2"], m * s["velocity_1_s"]
        j = inertia(frame)
        k_r, k_omega = j @ np.diag(np.square(s["attitude_rad_s"])), j @ np.diag(s["rate_1_s"])
        r, omega = of_quaternion(np.array(state["attitude_quaternion"])), np.array(state["rate_b_rad_s"])
        x, v = np.array(state["position_w_m"]), np.array(state["velocity_w_m_s"])
        x_d, v_d, a_d, j_d, s_d = of_reference(ref)
        # Forces here, accelerations in the limits.
        force = -k_x * (x - x_d) - k_v * (v - v_d) + m * g * E3 + m * a_d + drag * v
        per_mass, limited = limit(force / m, s, g)
        force = m * per_mass
        asked = force @ r @ E3
        low, high = [4 * frame["thrust_coefficient_n_s2"] * frame[f"rotor_{end}_rad_s"] ** 2 for end in ("min", "max")]
        f = min(max(asked, low), high)
        d_force, dd_force = np.zeros(3), np.zeros(3)
        if not limited:
            acc = (-m * g * E3 + f * r @ E3 - drag * v) / m
            d_force = -k_x * (v - v_d) - k_v * (acc - a_d) + m * j_d + drag * acc
            dr = r @ skew(omega)
            df = d_force @ r @ E3 + force @ dr @ E3 if asked == f else 0.0
            jerk = (df * r @ E3 + f * dr @ E3 - drag * acc) / m
            dd_force = -k_x * (acc - a_d) - k_v * (jerk - j_d) + m * s_d + drag * jerk
        yaw = Jet(ref["yaw_rad"], ref["yaw_rate_rad_s"], ref["yaw_acceleration_rad_s2"])
        b3 = direction(jets(force, d_force, dd_force))
        b2 = direction(cross(b3, [yaw.cos(), yaw.sin(), Jet(0.0)]))
        b1 = cross(b2, b3)
        part = lambda order: np.array([[getattr(b[i], order) for b in (b1, b2, b3)] for i in range(3)])
        r_d, dr_d, ddr_d = part("value"), part("d"), part("dd")
        omega_d_hat = r_d.T @ dr_d
        omega_d, d_omega_d = vee(omega_d_hat), vee(r_d.T @ ddr_d - omega_d_hat @ omega_d_hat)
        e_r = 0.5 * vee(r_d.T @ r - r.T @ r_d)
        turned = r.T @ r_d @ omega_d
        e_omega = omega - turned
        torque = (
            -k_r @ e_r - k_omega @ e_omega + np.cross(omega, j @ omega)
            - j @ (skew(omega) @ turned - r.T @ r_d @ d_omega_d)
            + frame["rotational_drag_nm_s"] * turned
        )
        room = 4 * np.max(np.abs(np.linalg.solve(allocation(frame), [0, torque[0], torque[1], 0])))
        self.f = min(max(f, min(low + room, m * g)), max(high - room, m * g))
        psi = 0.5 * np.trace(np.eye(3) - r_d.T @ r)
        self.shown = [np.linalg.norm(x - x_d), psi, *e_omega, float(limited)]
        return {"thrust_n": self.f, "torque_b_nm": list(torque), "telemetry": self.shown}


def wanted_motion(w):
    """Wanted attitude as a matrix, with rates and their derivative in its frame, by Taylor arithmetic."""
    phi, theta, psi = jets(w["attitude_rad"], w["attitude_rate_rad_s"], w["attitude_acceleration_rad_s2"])
    sf, cf, st, ct, sp, cp = phi.sin(), phi.cos(), theta.sin(), theta.cos(), psi.sin(), psi.cos()
    rows = [
        [cp * ct, cp * st * sf - sp * cf, cp * st * cf + sp * sf],
        [sp * ct, sp * st * sf + cp * cf, sp * st * cf - cp * sf],
        [-st, ct * sf, ct * cf],
    ]
    r, dr, ddr = [np.array([[getattr(x, order) for x in row] for row in rows]) for order in ("value", "d", "dd")]
    hat = r.T @ dr
    return r, vee(hat), vee(r.T @ ddr - hat @ hat)


class Indi:
    """Smeur, Chu, de Croon 2016, with measured torque and feedforward."""

    def __init__(self, frame, s, period):
        self.frame, self.s, self.period, self.last = frame, s, period, None
        self.torque = LowPass(s["filter_rad_s"], s["filter_damping"], period)
        self.rate_dot = LowPass(s["filter_rad_s"], s["filter_damping"], period)
        self.thrust, self.shown = frame["mass_kg"] * frame["gravity_m_s2"], [0.0] * 9

    def tick(self, tick, measured_tick, x, w, ref):
        if measured_tick != tick:
            return {"thrust_n": self.thrust, "torque_b_nm": [0.0] * 3, "telemetry": self.shown}
        i_m, omega = inertia(self.frame), np.array(x["rate_b_rad_s"])
        if self.last is not None:
            gap, before = tick - self.last[0], self.last[1]
            if gap == 1:
                thrusts = self.frame["thrust_coefficient_n_s2"] * np.array(x["rotor_speed_squared_mean_rad2_s2"])
                self.torque.take((allocation(self.frame) @ thrusts)[1:])
                self.rate_dot.take((omega - before) / self.period)
            elif gap * self.period > 0.1:
                self.torque.forget()
                self.rate_dot.forget()
        self.last = (tick, omega)
        r, (r_d, omega_d, d_omega_d) = of_quaternion(np.array(x["attitude_quaternion"])), wanted_motion(w)
        r_e = r.T @ r_d
        omega_r = np.array(self.s["attitude_1_s"]) * twice_half_angle_sine(r_e) + r_e @ omega_d
        nu = np.array(self.s["rate_1_s"]) * (omega_r - omega) + r_e @ d_omega_d
        tau = self.torque.output + i_m @ (nu - self.rate_dot.output)
        self.thrust = w["thrust_n"]
        left_over = self.rate_dot.output - np.linalg.solve(i_m, self.torque.output)
        self.shown = [*self.rate_dot.output, *self.torque.output, *left_over]
        return {"thrust_n": self.thrust, "torque_b_nm": list(tau), "telemetry": self.shown}


class Pid:
    """PX4's structure: reduced attitude with weighted yaw, rate PID, conditional integration."""

    def __init__(self, frame, s, period):
        self.frame, self.s, self.period, self.last = frame, s, period, None
        self.rate_dot, self.integral = LowPass(s["filter_rad_s"], 0.5**0.5, period), np.zeros(3)
        self.thrust, self.shown = frame["mass_kg"] * frame["gravity_m_s2"], [0.0] * 7

    def tick(self, tick, measured_tick, x, w, ref):
        if measured_tick != tick:
            return {"thrust_n": self.thrust, "torque_b_nm": [0.0] * 3, "telemetry": self.shown}
        s, frame, omega = self.s, self.frame, np.array(x["rate_b_rad_s"])
        if self.last is not None:
            gap, before = tick - self.last[0], self.last[1]
            if gap == 1:
                self.rate_dot.take((omega - before) / self.period)
            elif gap * self.period > 0.1:
                self.rate_dot.forget()
                self.integral = np.zeros(3)
        self.last = (tick, omega)
        r, (r_d, omega_d, _) = of_quaternion(np.array(x["attitude_quaternion"])), wanted_motion(w)
        axis = np.cross(r[:, 2], r_d[:, 2])
        sine = np.linalg.norm(axis)
        r_t = about(axis / sine, np.arctan2(sine, r[:, 2] @ r_d[:, 2])) @ r
        yaw = r_t.T @ r_d
        r_w = r_t @ about(E3, s["yaw_weight"] * np.arctan2(yaw[1, 0], yaw[0, 0]))
        gain = np.array(s["attitude_1_s"]) / np.array([1, 1, s["yaw_weight"]])
        omega_r = gain * twice_half_angle_sine(r.T @ r_w) + r.T @ r_d @ omega_d
        omega_r = np.clip(omega_r, -np.array(s["rate_max_rad_s"]), s["rate_max_rad_s"])
        e = omega_r - omega
        tau = inertia(frame) @ (
            np.array(s["rate_1_s"]) * e + self.integral - np.array(s["derivative"]) * self.rate_dot.output
        )
        self.thrust = w["thrust_n"]
        f = np.linalg.solve(allocation(frame), [self.thrust, *tau])
        low, high = [frame["thrust_coefficient_n_s2"] * frame[f"rotor_{end}_rad_s"] ** 2 for end in ("min", "max")]
        saturated = bool(np.any(f < low) or np.any(f > high))
        for i in range(3):
            taken = 0.0 if saturated and np.sign(e[i]) == np.sign(tau[i]) else e[i]
            factor = max(0.0, 1 - (e[i] / np.radians(400)) ** 2)
            bound = s["integral_max_rad_s2"][i]
            self.integral[i] = np.clip(
                self.integral[i] + s["integral_1_s2"][i] * factor * taken * self.period, -bound, bound
            )
        self.shown = [*e, *self.integral, float(saturated)]
        return {"thrust_n": self.thrust, "torque_b_nm": list(tau), "telemetry": self.shown}


def uniform(low, high, size=None):
    return np.round(RNG.uniform(low, high, size), 4).tolist()


def random_frame():
    inertia_xyz = np.round(RNG.uniform(0.004, 0.02, 3), 5).tolist()
    return {
        "mass_kg": uniform(0.4, 0.7), "gravity_m_s2": uniform(9.7, 9.9),
        "translational_drag_kg_s": uniform(0.0, 1.2), "rotational_drag_nm_s": uniform(0.0, 0.2),
        "arm_length_m": uniform(0.15, 0.25), "thrust_coefficient_n_s2": 3.13e-5, "drag_factor_nm_s2": 7.5e-7,
        **{f"inertia_{axis}_kg_m2": value for axis, value in zip("xyz", inertia_xyz)},
        "rotor_min_rad_s": 30.0, "rotor_max_rad_s": 350.0,
    }


def cascade_gains(attitude, rate):
    return {attitude: uniform(1.0, 12.0, 3), rate: uniform(12.0, 60.0, 3)}


def random_settings(law):
    position = {"position_1_s2": uniform(0.5, 8.0), "velocity_1_s": uniform(0.5, 6.0)}
    limits = {
        "acceleration_z_min_g": uniform(0.2, 0.5), "acceleration_z_max_g": uniform(1.5, 2.0),
        "tilt_max_rad": uniform(0.5, 1.2),
    }
    if law is Estimating:
        return {**position, **limits, "thrust_scale_gain_s3_m2": uniform(0.0, 0.5), "drag_gain_s_m2": uniform(0.0, 5.0)}
    if law is Geometric:
        return {**position, **limits, **cascade_gains("attitude_rad_s", "rate_1_s")}
    gains = {**cascade_gains("attitude_1_s", "rate_1_s"), "filter_rad_s": uniform(20.0, 200.0)}
    if law is Indi:
        return {**gains, "filter_damping": uniform(0.4, 1.2)}
    return {
        **gains, "yaw_weight": uniform(0.2, 1.0), "rate_max_rad_s": uniform(1.0, 8.0, 3),
        "integral_1_s2": uniform(0.0, 5000.0, 3), "derivative": uniform(0.0, 0.8, 3),
        "integral_max_rad_s2": uniform(0.5, 20.0, 3),
    }


def jittered(value, spread):
    return (np.array(value) + RNG.normal(0.0, spread, np.shape(value))).round(5).tolist()


def inputs(law, centre, w_centre, r_centre, size):
    """Measured, wanted and reference of a tick, near those of the case; only what the law may look at."""
    near = lambda key, spread: jittered(centre[key], spread)
    x = {}
    if law in (Estimating, Geometric):
        x = {"position_w_m": near("position_w_m", 0.02), "velocity_w_m_s": near("velocity_w_m_s", 0.02)}
    if law in (Estimating, Indi):
        x["rotor_speed_squared_mean_rad2_s2"] = RNG.integers(10000, 90000, 4).astype(float).tolist()
    if law is Estimating:
        x["attitude_rad"] = near("attitude_rad", 0.02)
    else:
        x["rate_b_rad_s"] = near("rate_b_rad_s", 0.05 * size)
        q = np.array(centre["attitude_quaternion"]) + RNG.normal(0.0, 0.02 * size, 4)
        x["attitude_quaternion"] = (q / np.linalg.norm(q)).tolist()
    wanted = {key: jittered(value, 0.01 * size) for key, value in w_centre.items()}
    reference = {key: jittered(value, 0.01 * size) for key, value in r_centre.items()}
    return x, wanted, reference


def fifteen_digits(value):
    if isinstance(value, bool):
        return value
    return [fifteen_digits(x) for x in value] if isinstance(value, list) else float(f"{value:.15g}")


def case(law):
    frame, settings = random_frame(), random_settings(law)
    period = float(RNG.choice([0.001, 0.002, 0.004]))
    size = float(RNG.choice([0.02, 0.3, 1.0]))
    wanted_attitude = RNG.uniform(-1.0, 1.0, 3)
    error = RNG.normal(0.0, 0.6 * size, 3)
    angle = min(np.linalg.norm(error), 2.4)
    r = euler(wanted_attitude) @ about(error / np.linalg.norm(error), angle)
    if law is Geometric:
        r = euler(RNG.uniform(-3.0, 3.0, 3))
    w = 0.5 * np.sqrt(max(0.0, 1 + np.trace(r)))
    centre = {
        "position_w_m": (size * RNG.normal(0, 1, 3)).tolist(), "velocity_w_m_s": (size * RNG.normal(0, 1, 3)).tolist(),
        "attitude_rad": RNG.uniform(-0.8, 0.8, 3).tolist(), "attitude_quaternion": [w, *(vee(r) / (2 * w))],
        "rate_b_rad_s": (size * RNG.normal(0, 1, 3)).tolist(),
    }
    w_centre = {
        "thrust_n": float(RNG.uniform(2.0, 9.0)), "attitude_rad": wanted_attitude.tolist(),
        "attitude_rate_rad_s": (size * RNG.normal(0, 0.5, 3)).tolist(),
        "attitude_acceleration_rad_s2": (size * RNG.normal(0, 2.0, 3)).tolist(),
    }
    r_centre = {key: (size * RNG.normal(0, 1, 3)).tolist() for key in
                ("position_w_m", "velocity_w_m_s", "acceleration_w_m_s2", "jerk_w_m_s3", "snap_w_m_s4")}
    r_centre |= {"yaw_rad": float(RNG.uniform(-3, 3)), "yaw_rate_rad_s": float(RNG.normal()),
                 "yaw_acceleration_rad_s2": float(RNG.normal())}
    sampled = law(frame, settings, period)
    uses_wanted, uses_reference = law in (Indi, Pid), law in (Estimating, Geometric)
    tick, rows, before = int(RNG.integers(0, 1000)), [], None
    for _ in range(TICKS):
        x, wanted, reference = inputs(law, centre, w_centre, r_centre, size)
        held = law is not Estimating and before is not None and RNG.uniform() < 0.1
        measured_tick = before if held else tick
        out = sampled.tick(tick, measured_tick, x, wanted, reference)
        row = {"tick": tick, "measured_tick": measured_tick, "measured": x}
        row |= {"wanted": wanted} if uses_wanted else {}
        row |= {"reference": reference} if uses_reference else {}
        rows.append(row | {"out": {key: fifteen_digits(value) for key, value in out.items()}})
        before = measured_tick
        tick += int(RNG.choice([1, 2, 5, 150], p=[0.85, 0.05, 0.05, 0.05]))
    return {"period_s": period, "airframe": frame, "settings": settings, "ticks": rows}


def main():
    vectors = {law.__name__.lower(): [case(law) for _ in range(CASES)] for law in (Estimating, Geometric, Indi, Pid)}
    path = pathlib.Path(__file__).with_name("laws.json")
    path.write_text(json.dumps(vectors, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
