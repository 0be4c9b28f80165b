"""Special points whose numbers are known, by `continuation` and by jaxcont: errors, seconds of a first answer
(compiling among them), lines of a user's code.

    python -m benchmarks.alone
"""

import inspect
import time

import jax
import jax.numpy as jnp
import jaxcont
import numpy as np

import continuation as co
from tests.test_trace import bratu, brusselator

BRATU, HOPF = 3.51364790397, 2.0


def our_fold():
    found = co.trace(co.equilibria(bratu), np.zeros(99), {"p": 0.0}, "p", (-0.1, 4.0), stop=["SN"], largest_step=2.0)
    return found.points("SN")[0].p["p"]


def their_fold():
    def field(u, p, args):
        return bratu(u, {"p": p}, args)

    problem = jaxcont.bif_problem(field, jnp.zeros(99), 0.0)
    settings = jaxcont.ContinuationPar(ds=0.1, ds_max=2.0, newton_tol=1e-10, compute_stability=False, max_steps=60)
    found = jaxcont.continuation(problem, p_span=(0.0, 4.0), settings=settings, events=[jaxcont.Fold()])
    return found.events[0].p


def our_hopf():
    found = co.trace(co.equilibria(brusselator), [1.0, 1.0], {"a": 1.0, "b": 1.0}, "b", (0.5, 3.0))
    return found.points("HB")[0].p["b"]


def their_hopf():
    def field(u, b, args):
        return brusselator(u, {"a": 1.0, "b": b}, args)

    problem = jaxcont.bif_problem(field, jnp.array([1.0, 1.0]), 1.0)
    settings = jaxcont.ContinuationPar(newton_tol=1e-10)
    found = jaxcont.continuation(problem, p_span=(1.0, 3.0), settings=settings, events=[jaxcont.Hopf()])
    return found.events[0].p


def lines(function):
    """Lines of a function's body, as they are written."""
    return sum(bool(line.strip()) for line in inspect.getsource(function).splitlines()[1:])


def main():
    jax.config.update("jax_enable_x64", True)
    print(f"{'problem':32}{'error':>10}{'s':>8}{'lines':>7}")
    for name, function, true in (
        ("Bratu's fold, continuation", our_fold, BRATU),
        ("Bratu's fold, jaxcont", their_fold, BRATU),
        ("Brusselator's Hopf, continuation", our_hopf, HOPF),
        ("Brusselator's Hopf, jaxcont", their_hopf, HOPF),
    ):
        begun = time.perf_counter()
        try:
            error = f"{abs(float(function()) - true):.1e}"
        except (ValueError, IndexError, RuntimeError) as failed:  # as a rival's user sees it
            error = type(failed).__name__
        print(f"{name:32}{error:>10}{time.perf_counter() - begun:8.1f}{lines(function):7d}", flush=True)


if __name__ == "__main__":
    main()
