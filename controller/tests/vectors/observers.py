"""Vectors for `adaptive` with a residual and for the laws with an observer of the disturbance, in numpy.

Nothing here is shared with the Rust laws, and the ways differ where they can: the command filter is the exponential of
its matrix; rates come from Taylor arithmetic, and the rotation between attitudes from matrices; the estimates are those
of immersion and invariance by the implicit midpoint rule; the super-twisting inclusion and the predictors
are solved for their next value. Run by hand: `python3 controller/tests/vectors/observers.py` writes observers.json.
"""

import json
import pathlib

import numpy as np

import laws
from laws import Jet, allocation, fifteen_digits, inertia, jets, jittered, random_frame, uniform

CASES, TICKS = 8, 10
LONG_S = 0.1


def exponential(a):
    """exp(a), by its series, after halving."""
    a, total, term = a / 64, np.eye(len(a)), np.eye(len(a))
    for n in range(1, 20):
        term = term @ a / n
        total = total + term
    for _ in range(6):
        total = total @ total
    return total


class Filter:
    """ec'' = win - 2 w ec' - w^2 ec, exact for a held win: the exponential of its matrix, with win as a third state."""

    def __init__(self, w, period):
        self.matrices = [np.array([[0, 1, 0], [-x * x, -2 * x, 1], [0, 0, 0]]) for x in w]
        self.period, self.state, self.win = period, np.zeros((3, 2)), np.zeros(3)

    def at_rest(self, eta):
        self.state = np.column_stack([eta, np.zeros(3)])

    def advance(self, ticks):
        for i, a in enumerate(self.matrices):
            self.state[i] = (exponential(a * self.period * ticks) @ [*self.state[i], self.win[i]])[:2]

    def acceleration(self):
        return np.array([a[1] @ [*self.state[i], self.win[i]] for i, a in enumerate(self.matrices)])


def times(a, b):
    """A product of matrices of jets."""
    return [[sum((a[i][k] * b[k][j] for k in range(3)), Jet(0.0)) for j in range(3)] for i in range(3)]


def turned(eta):
    """The rotation of Euler angles that are jets."""
    phi, theta, psi = eta
    sf, cf, st, ct, sp, cp = phi.sin(), phi.cos(), theta.sin(), theta.cos(), psi.sin(), psi.cos()
    about_x = [[Jet(1.0), Jet(0.0), Jet(0.0)], [Jet(0.0), cf, -sf], [Jet(0.0), sf, cf]]
    about_y = [[ct, Jet(0.0), st], [Jet(0.0), Jet(1.0), Jet(0.0)], [-st, Jet(0.0), ct]]
    about_z = [[cp, -sp, Jet(0.0)], [sp, cp, Jet(0.0)], [Jet(0.0), Jet(0.0), Jet(1.0)]]
    return times(about_z, times(about_y, about_x))


def spin(r):
    """Body rates of a rotation, as jets without second derivative: of dR = R S(nu)."""
    back = [[Jet(r[j][i].value) for j in range(3)] for i in range(3)]
    rate = [[Jet(r[i][j].d) for j in range(3)] for i in range(3)]
    s = times(back, rate)
    return np.array([s[2][1].value, s[0][2].value, s[1][0].value])


class Law:
    """The attitude and rate loop; a subclass says what the model does not explain."""

    def __init__(self, frame, s, period):
        self.frame, self.s, self.period = frame, s, period
        self.filter, self.filter_tick = Filter(s["command_filter_rad_s"], period), 0
        self.a_d = (1 - np.exp(-s["alpha_1_s"] * period)) / period
        self.last, self.shown = None, [0.0] * self.SIGNALS
        self.i_m = inertia(frame)

    def coupling(self, nu):
        return np.linalg.solve(self.i_m, -np.cross(nu, self.i_m @ nu))

    def reference(self, eta, nu):
        """nu2_d and its derivative."""
        (ec, e1), e2 = self.filter.state.T, self.filter.acceleration()
        k = np.array(self.s["attitude_1_s"])
        sf, cf, tt, ct = np.sin(eta[0]), np.cos(eta[0]), np.tan(eta[1]), np.cos(eta[1])
        d_eta = np.array([[1, sf * tt, cf * tt], [0, cf, -sf], [0, sf / ct, cf / ct]]) @ nu
        if self.s["attitude"] == "euler":
            error = ec - eta
            error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
            phi, theta = Jet(eta[0], d_eta[0]), Jet(eta[1], d_eta[1])
            xi = jets(e1 + k * error, e2 + k * (e1 - d_eta), [0] * 3)
            sf, cf, st, ct = phi.sin(), phi.cos(), theta.sin(), theta.cos()
            wanted = [xi[0] - st * xi[2], cf * xi[1] + sf * ct * xi[2], cf * ct * xi[2] - sf * xi[1]]
            return np.array([x.value for x in wanted]), np.array([x.d for x in wanted])
        r, r_d = turned(jets(eta, d_eta, [0] * 3)), turned(jets(ec, e1, e2))
        back = [[r[j][i] for j in range(3)] for i in range(3)]
        r_e = times(back, r_d)
        scalar = (1.0 + r_e[0][0] + r_e[1][1] + r_e[2][2]).sqrt() * 0.5
        skew = [r_e[2][1] - r_e[1][2], r_e[0][2] - r_e[2][0], r_e[1][0] - r_e[0][1]]
        vector = [x * 0.25 * scalar.inverse() for x in skew]
        # Rates of the desired frame, with derivative: R_d^T dR_d is skew.
        moved = [[Jet(r_d[i][j].d, r_d[i][j].dd) for j in range(3)] for i in range(3)]
        w = times([[r_d[j][i] for j in range(3)] for i in range(3)], moved)
        w_d = [w[2][1], w[0][2], w[1][0]]
        w_b = [sum((r_e[i][j] * w_d[j] for j in range(3)), Jet(0.0)) for i in range(3)]
        wanted = [2 * k[i] * vector[i] + w_b[i] for i in range(3)]
        assert np.allclose(spin(r), nu) and scalar.value > 0
        return np.array([x.value for x in wanted]), np.array([x.d for x in wanted])

    def tick(self, tick, measured_tick, x, w):
        fresh = measured_tick == tick
        long = self.last is None or (tick - self.last[0]) > round(LONG_S / self.period)
        if fresh and long:
            self.filter.at_rest(x["attitude_rad"])
        elif tick > self.filter_tick:
            self.filter.advance(tick - self.filter_tick)
        w_f = np.array(self.s["command_filter_rad_s"])
        r, r1, r2 = [np.array(w[key]) for key in
                     ("attitude_rad", "attitude_rate_rad_s", "attitude_acceleration_rad_s2")]
        self.filter.win = r2 + 2 * w_f * r1 + w_f**2 * r
        tau = np.zeros(3)
        if fresh:
            nu = np.array(x["rate_b_rad_s"])
            speeds = np.array(x["rotor_speed_mean_rad_s"])
            om = speeds @ [1, -1, 1, -1]
            if self.last is not None and self.last[0] == tick - 1:
                thrusts = self.frame["thrust_coefficient_n_s2"] * np.array(x["rotor_speed_squared_mean_rad2_s2"])
                v = np.linalg.solve(self.i_m, (allocation(self.frame) @ thrusts)[1:])
                f = (self.coupling(self.last[1]) + self.coupling(nu)) / 2
                self.take(tick, self.last[1], nu, v + f, om)
            else:
                self.restart(nu, long)
            self.last = (tick, nu)
            nu_d, dnu_d = self.reference(np.array(x["attitude_rad"]), nu)
            e = nu - nu_d
            tau = self.i_m @ (dnu_d - self.a_d * e - self.coupling(nu) - self.left(tick, nu, om))
            self.shown = [*e, *self.estimates()]
        self.filter.advance(1)
        self.filter_tick = tick + 1
        return {"thrust_n": w["thrust_n"], "torque_b_nm": tau.tolist(), "telemetry": [float(x) for x in self.shown]}


class L1(Law):
    SIGNALS = 9

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.nu_hat, self.sigma, self.l = np.zeros(3), np.zeros(3), np.zeros(3)

    def take(self, tick, start, end, gained, om):
        # d(nu_hat) = A_s (nu_hat - nu_) + gained + sigma, all but nu_hat held: the exponential of its matrix.
        a_s = -self.s["predictor_1_s"]
        grown = exponential(np.array([[a_s, 1], [0, 0]]) * self.period)
        self.nu_hat = start + grown[0, 0] * (self.nu_hat - start) + self.period * gained + grown[0, 1] * self.sigma
        # sigma makes the predictor forget its error within a tick: E nt + P sigma = 0.
        self.sigma = np.array([-grown[0, 0] * x / grown[0, 1] for x in self.nu_hat - end])
        share = np.exp(-self.s["filter_rad_s"] * self.period)
        self.l = self.sigma + share * (self.l - self.sigma)

    def restart(self, nu, long):
        self.nu_hat, self.sigma, self.l = nu, np.zeros(3), np.zeros(3) if long else self.l

    def left(self, tick, nu, om):
        return self.l

    def estimates(self):
        return [*self.sigma, *self.l]


class Mrac(Law):
    SIGNALS = 12

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.nu_m, self.eps, self.a, self.d = (np.zeros(3) for _ in range(4))

    def take(self, tick, start, end, gained, om):
        s, period, mid = self.s, self.period, (start + end) / 2
        kept = np.exp(-s["model_1_s"] * period)
        self.nu_m = start + kept * (self.nu_m - start) + period * (gained + self.a * mid + self.d)
        self.eps = end - self.nu_m
        gains = np.array([s["gain_rate_1_rad2"], s["gain_bias_1_s2"]])
        for i in range(3):
            regressor = np.array([mid[i], 1.0])
            rate = period / (1 + period**2 * regressor**2 @ gains)
            learnt = np.array([self.a[i], self.d[i]])
            learnt = learnt + rate * gains * (regressor * self.eps[i] - s["modification"] * abs(self.eps[i]) * learnt)
            self.a[i], self.d[i] = np.clip(learnt, [-150, -100], [20, 100])

    def restart(self, nu, long):
        self.nu_m, self.eps = nu, np.zeros(3)
        if long:
            self.a, self.d = np.zeros(3), np.zeros(3)

    def left(self, tick, nu, om):
        return self.a * nu + self.d

    def estimates(self):
        return [*self.eps, *self.a, *self.d]


class Sliding(Law):
    SIGNALS = 6

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.nu_hat, self.w = np.zeros(3), np.zeros(3)

    def take(self, tick, start, end, gained, om):
        h = self.period
        for i, l in enumerate(self.s["disturbance_rate_rad_s3"]):
            k1, k2 = 1.5 * l**0.5, 1.1 * l
            # z = nu - nu_hat: z+ = b - h k1 sqrt|z+| sgn z+ - h^2 k2 sgn z+, w+ = w + h k2 sgn z+. Solved for sqrt|z+|.
            pred = self.nu_hat[i] + h * gained[i]
            b = end[i] - pred - h * self.w[i]
            if abs(b) > h * h * k2:
                root = max(np.roots([1, h * k1, h * h * k2 - abs(b)]).real)
                z, sign = np.sign(b) * root**2, np.sign(b)
            else:
                z, sign = 0.0, b / (h * h * k2)
            self.nu_hat[i], self.w[i] = end[i] - z, self.w[i] + h * k2 * sign

    def restart(self, nu, long):
        self.nu_hat = nu.copy()
        if long:
            self.w = np.zeros(3)

    def left(self, tick, nu, om):
        return self.w

    def estimates(self):
        return self.w


class AdaptiveResidual(Law):
    SIGNALS = 9

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.theta = np.clip(np.zeros(3), self.s["estimate_min"], self.s["estimate_max"])
        self.x, self.y, self.l = np.zeros((3, 3)), np.zeros(3), np.zeros(3)

    def h(self, tick):
        return np.sin(tick * self.period) * np.array([1, 0.8, 0.6])

    def phi(self, nu, om, h):
        gyroscopic = -np.cross(nu, [0, 0, om])
        return np.column_stack([np.linalg.solve(self.i_m, gyroscopic), np.linalg.solve(self.i_m, -nu), h])

    def take(self, tick, start, end, gained, om):
        s, period = self.s, self.period
        phi = self.phi((start + end) / 2, om, (self.h(tick - 1) + self.h(tick)) / 2)
        y = (end - start) / period - gained
        kept = np.exp(-s["regressor_filter_rad_s"] * period) if s["regressor_filter_rad_s"] > 0 else 0.0
        self.x, self.y = phi + kept * (self.x - phi), y + kept * (self.y - y)
        g = np.diag(s["adaptation_gain"]) / s["alpha_1_s"]
        # Immersion and invariance, implicit midpoint: (1 + T G X'X) est+ = est + T G X' y.
        left = np.eye(3) + period * g @ self.x.T @ self.x
        theta = np.linalg.solve(left, self.theta + period * g @ self.x.T @ self.y)
        self.theta = np.clip(theta, s["estimate_min"], s["estimate_max"])
        share, unexplained = np.exp(-s["residual_filter_rad_s"] * period), y - phi @ self.theta
        self.l = unexplained + share * (self.l - unexplained)

    def restart(self, nu, long):
        if long:
            self.l = np.zeros(3)

    def left(self, tick, nu, om):
        return self.phi(nu, om, self.h(tick)) @ self.theta + self.l

    def estimates(self):
        return [*self.theta, *self.l]


def random_settings(law):
    shared = {
        "attitude": str(laws.RNG.choice(["euler", "quaternion"])), "attitude_1_s": uniform(1.0, 12.0, 3),
        "command_filter_rad_s": uniform(2.0, 40.0, 3), "alpha_1_s": uniform(20.0, 200.0),
    }
    if law is L1:
        return shared | {"predictor_1_s": uniform(1.0, 50.0), "filter_rad_s": uniform(20.0, 200.0)}
    if law is Mrac:
        return shared | {"model_1_s": uniform(20.0, 200.0), "gain_rate_1_rad2": uniform(0.0, 2e4),
                         "gain_bias_1_s2": uniform(0.0, 5e3), "modification": uniform(0.0, 0.1)}
    if law is Sliding:
        return shared | {"disturbance_rate_rad_s3": (10.0 ** laws.RNG.uniform(1, 5, 3)).round(2).tolist()}
    return shared | {
        "adaptation": "on", "adaptation_gain": [float(10.0**x) for x in laws.RNG.uniform([-6, -2, 0], [-3, 1, 3])],
        "regressor_filter_rad_s": float(laws.RNG.choice([0.0, 50.0])), "estimate_min": [-1e-3, 0.0, -2.0],
        "estimate_max": [1e-3, 1.0, 2.0], "residual_filter_rad_s": uniform(10.0, 200.0),
    }


def case(law):
    frame, settings = random_frame(), random_settings(law)
    period = float(laws.RNG.choice([0.001, 0.002]))
    eta, nu = laws.RNG.uniform(-0.8, 0.8, 3), laws.RNG.normal(0, 0.5, 3)
    wanted = {
        "thrust_n": float(laws.RNG.uniform(2.0, 9.0)), "attitude_rad": (eta + laws.RNG.normal(0, 0.2, 3)).tolist(),
        "attitude_rate_rad_s": laws.RNG.normal(0, 0.5, 3).tolist(),
        "attitude_acceleration_rad_s2": laws.RNG.normal(0, 2.0, 3).tolist(),
    }
    sampled = law(frame, settings, period)
    tick, rows, before = int(laws.RNG.integers(0, 1000)), [], None
    for _ in range(TICKS):
        speeds = laws.RNG.uniform(190.0, 215.0, 4).round(4)
        x = {
            "attitude_rad": jittered(eta, 0.01), "rate_b_rad_s": jittered(nu, 0.02),
            "rotor_speed_mean_rad_s": speeds.tolist(),
            "rotor_speed_squared_mean_rad2_s2": (speeds**2 + laws.RNG.uniform(0, 10, 4)).round(4).tolist(),
        }
        w = {key: jittered(value, 0.01) for key, value in wanted.items()}
        # Without a measurement `adaptive` shows that its rate error is unknown, which no vector can say.
        held = law is not AdaptiveResidual and before is not None and laws.RNG.uniform() < 0.1
        measured_tick = before if held else tick
        out = sampled.tick(tick, measured_tick, x, w)
        row = {"tick": tick, "measured_tick": measured_tick, "measured": x, "wanted": w}
        rows.append(row | {"out": {key: fifteen_digits(value) for key, value in out.items()}})
        before = measured_tick
        tick += int(laws.RNG.choice([1, 2, 5, 150], p=[0.85, 0.05, 0.05, 0.05]))
    return {"period_s": period, "airframe": frame, "settings": settings, "ticks": rows}


def main():
    laws.RNG = np.random.default_rng(20230214)
    names = {"l1": L1, "mrac": Mrac, "sliding": Sliding, "adaptive_residual": AdaptiveResidual}
    vectors = {name: [case(law) for _ in range(CASES)] for name, law in names.items()}
    path = pathlib.Path(__file__).with_name("observers.json")
    path.write_text(json.dumps(vectors, separators=(",", ":")) + "\n")


main()
