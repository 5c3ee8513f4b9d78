"""Errata: the equations as printed and in the form that works, each with its derivation."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..types import Array
from . import drawn
from .cases import case, explored, signals
from .judging import Bound, Claim, erratum
from .lab import Lab
from .printed import DT, Map
from .records import Experiment, Readings, Trial, column

if TYPE_CHECKING:
    from ..body.gp.model import GP

LASTING = 60.0
"""s for which the belief is integrated."""


def _run(lab: Lab, seed: int, tried: Readings) -> Trial:
    observed = drawn.log(15.0, 0.02, seed, (True, True, False))
    known = explored(lab.body("paper", seed, "horizontal"))
    log = signals(observed)
    learned = known.map({"sigma_n": "learned"})
    model = lab.body("default", seed, "horizontal").senses["effector"]
    least = least_eigenvalues(model)  # type: ignore[arg-type]
    size, jacobian = jacobian_errors(learned)
    ascent = ends({"up": 1.0, "down": -1.0}, log.true[0], log.encoders)
    multiplied = {f"multiplied {n} {m}": float(multiplications(n, m)) for n, m in ((4, 4), (8, 4), (8, 8), (16, 16))}
    figures = {
        "printed prior": grown(log.encoders, True),
        "ours prior": grown(log.encoders, False),
        "printed step": stable_step(learned, log.true[0], 1.0),
        "ours step": stable_step(learned, log.true[0], known.scatter),
        "printed jacobian": size,
        "ours jacobian": jacobian,
        "printed least eigenvalue": least[0],
        "ours least eigenvalue": least[1],
        "printed sign": ascent["down"],
        "ours sign": ascent["up"],
        "printed touch": touch_error(learned, case(known, {}, "p+v", log.true[0]).start, log.place[0])[0],
        "ours touch": touch_error(learned, case(known, {}, "p+v", log.true[0]).start, log.place[0])[1],
    } | multiplied
    return {"figures": figures, "panels": []}


def grown(encoders: Array, as_printed: bool) -> float:
    """log₁₀ of the largest belief (rad) in 60 s of Algorithm 1 on encoders, with μ̇ = μ + λe_x or μ̇ = λe_x."""
    x = mu = s = encoders[0]
    ex, ep, most = np.zeros(3), np.zeros(3), 0.0
    for _ in range(int(LASTING / DT)):
        dmu = ex + mu if as_printed else ex
        dx, dex, dep = ep - ex, x - mu - ex, s - x - ep
        x, mu, ex, ep = x + DT * dx, mu + DT * dmu, ex + DT * dex, ep + DT * dep
        most = max(most, float(np.abs(x).max()))
    return float(np.log10(most))


def ends(signs: dict[str, float], start: Array, encoders: Array) -> dict[str, float]:
    """Distance (rad) from the encoders after 5 s along +∂F/∂x or −∂F/∂x, F as printed, from 0.1 rad off."""
    found = {}
    for name, sign in signs.items():
        x = start + 0.1
        for _ in range(int(5.0 / DT)):
            x = x + sign * DT * (encoders[0] - x)
        found[name] = float(np.abs(x - encoders[0]).max())
    return found


def stable_step(model: Map, x: Array, unit: float) -> float:
    """Largest Δt (s) at which one Euler step of Algorithm 1 with σ_v = 5 (unit px)² shrinks every mode at x (M,)."""
    m, jac = len(x), _slope(model, x) / unit
    a = np.zeros((4 * m + 2, 4 * m + 2))  # x, e_x, μ, e_p, e_v
    i, o = np.eye(m), slice(4 * m, None)
    a[:m, m : 2 * m], a[m : 2 * m, :m], a[m : 2 * m, 2 * m : 3 * m] = -i, i, -i
    a[m : 2 * m, m : 2 * m], a[2 * m : 3 * m, m : 2 * m] = -i, i
    a[:m, 3 * m : 4 * m], a[3 * m : 4 * m, :m], a[3 * m : 4 * m, 3 * m : 4 * m] = i, -i, -i
    a[:m, o], a[o, :m], a[o, o] = jac.T, -jac, -5.0 * np.eye(2)
    modes = np.linalg.eigvals(a)
    modes = modes[modes.real < -1e-9]
    return float((-2.0 * modes.real / np.abs(modes) ** 2).min())


def _slope(model: Map, x: Array) -> Array:
    """∂g/∂x (2,M) px/rad by central differences."""
    steps = 1e-5 * np.eye(len(x))
    return np.asarray((model.at(x + steps) - model.at(x - steps)).T / 2e-5)


def jacobian_errors(model: Map) -> tuple[float, float]:
    """Relative error of the Jacobian against central differences: with the length scales as printed, and ours."""
    x = np.median(model.x, axis=0) + 0.05
    slope = _slope(model, x)
    apart = (x - model.x) / model.scales
    kernel = np.exp(-0.5 * (apart**2).sum(axis=1))[:, None] * model.weights
    own = -np.einsum("nd,nm->dm", kernel, apart / model.scales)
    off = (np.abs(found - slope).max() / np.abs(slope).max() for found in (own * model.scales**4, own))
    return tuple(float(v) for v in off)  # type: ignore[return-value]


def least_eigenvalues(model: "GP") -> tuple[float, float]:
    """The least eigenvalue of K over σ_n², with the learned kernel: σ_n² on every entry of K, and on its diagonal."""
    x, noise = model.samples[::8], float(model.noise[0] / model.amplitude[0])
    k = np.exp(-0.5 * np.square((x[:, None] - x[None]) / model.scales[0]).sum(axis=2))
    everywhere, diagonal = np.linalg.eigvalsh(k + noise)[0], np.linalg.eigvalsh(k + noise * np.eye(len(k)))[0]
    return float(everywhere / noise), float(diagonal / noise)


def multiplications(senses: int, joints: int) -> int:
    """Multiplications in one step's Σ_i e_i g_i′ over senses of one value each, counted while it is computed."""
    count, total = 0, [0.0] * joints
    for i in range(senses):
        for j in range(joints):
            total[j] += float(i) * float(j)
            count += 1
    return count


def touch_error(model: Map, x: Array, seen: Array) -> tuple[float, float]:
    """Spread (px) over a wrong belief of the distance in f_s: of s_v − s_o, as in the set-up, and of g_v − o_v."""
    beliefs = x + 0.1 * np.linspace(-1.0, 1.0, 9)[:, None]
    apart = model.at(beliefs) - seen
    return float(np.std(np.linalg.norm(np.tile(seen - seen, (9, 1)), axis=1))), float(
        np.std(np.linalg.norm(apart, axis=1))
    )


DERIVATIONS = {
    "prior": "μ̇ = μ + λe_x has the solution e^t where e_x = 0; the algorithm's step μ ← μ + λe_x is meant; "
    "as a rate that is μ̇ = λe_x.",
    "step": "Ẋ = AX with A from J, σ: an Euler step shrinks a mode a when Δt < −2 Re a/|a|²; for vision |a|² ≈ |J|², "
    "Re a = −σ_v/2, so Δt < σ_v/|J|²; |J| is some 300 px/rad and 7 per scatter.",
    "jacobian": "∂/∂x exp(−½ (x − X)ᵀΛ(x − X)) = −Λ(x − X)ᵀ k with Λ = diag(1/l²); printed is −Λ⁻¹(x̂ − X)ᵀ; "
    "the two differ by l⁴.",
    "least eigenvalue": "k + σ_n² on every entry is K + σ_n² 1 1ᵀ; it adds to the one direction 1 only; "
    "Algorithm 1 itself has σ_n² I, which adds to all.",
    "sign": "F = ln p(s|x̂) + ln p(x̂) is named negative free energy: its maximum is sought; "
    "the text minimises F and follows ẋ = +∂F/∂x, which ascends; +∂F/∂x is right, 'minimise' is −F's.",
    "cost": "Σ_i e_i g_i′ adds N products of a number with M slopes; that is N·M multiplications; "
    "a step is O(N·M), not O(N + M).",
    "touch": "the set-up fits a_1 exp(−b_1 Σ(s_v − s_o)²), Eq. touch has g_v(x) − o_v; s_v − s_o does not depend on x̂; "
    "with it ∂g_t/∂x̂ = 0 and touch could not move the belief.",
    "origin": "a_1, b_1, a_2, b_2 are 'tuned in concordance with data from human participants' (Eq. touch); "
    "a_1, b_1 'have been obtained by fitting the function to the distance-sensor output' (set-up); "
    "both cannot be: here a = 1, b_1 is fitted to touches, b_2 is a constant of perception.",
    "s_x": "ė_x = s_x − μ_x − σ_x e_x: s_x is defined nowhere; at rest e_x must be (x̂ − μ_x)/σ_x; "
    "Algorithm 1 has x̂ − μ_x − σ_x e_x.",
    "s_p": "F's second term is ln f(s_p; g_v(x̂), σ_v): encoders compared with pixels; "
    "its own expansion has (s_v − g_v(x̂))²; ln f(s_v; g_v, σ_v) is meant.",
}
"""Each erratum's derivation, in three parts."""


EQUATIONS: tuple[tuple[str, str, str, str, Bound], ...] = (
    ("prior", "μ̇ = μ + λe_x keeps the belief within 10 rad for 60 s",
     "log₁₀ of the largest belief", "log₁₀ rad", Bound("≤", 1.0)),
    ("step", "explicit Euler is stable at Δt = 0.05 s with σ_v = 5 px²; run with σ_v in squared scatters",
     "largest stable step", "s", Bound("≥", DT)),
    ("jacobian", "−Λ⁻¹(x̂ − X) with Λ = diag(1/l²) is the derivative",
     "relative error against differences", "1", Bound("≤", 1e-3)),
    ("least eigenvalue", "k_ij = σ_n² + k regularises K",
     "least eigenvalue of K over σ_n²", "1", Bound("≥", 0.5)),
    ("sign", "F as printed is minimised: run as ascent",
     "distance from the encoders after 5 s", "rad", Bound("≤", 0.05)),
    ("touch", "the distance in f_s is s_v − s_o: run as g_v − o_v",
     "how far it depends on the belief", "px", Bound("≥", 1.0)),
)  # fmt: skip
"""Figure's name · the printed claim · what is measured, its unit and bound; numbered from 1."""


def _claims(trials: Sequence[Trial], tried: Readings) -> tuple[Claim, ...]:
    def compared(name: str) -> dict[str, Sequence[float]]:
        return {"as printed": column(trials, f"printed {name}"), "as run": column(trials, f"ours {name}")}

    products = {"N + M, as printed": [32.0] * len(trials), "counted, N = M = 16": column(trials, "multiplied 16 16")}
    cost = "the optimisation costs O(N + M): multiplications of Σ e g′ are N·M"
    return (
        *(
            erratum(f"Errata.{k}", text, measured, unit, bound, compared(name), DERIVATIONS[name])
            for k, (name, text, measured, unit, bound) in enumerate(EQUATIONS, 1)
        ),
        erratum("Errata.7", cost, "multiplications", "1", Bound("≥", 256.0), products, DERIVATIONS["cost"]),
    )


EXPERIMENT = Experiment("Errata", "The equations as printed", _run, _claims)
