"""Map the states with the paper's method, which `jaxvibro.paper` measures too."""

from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, Strobes
from jaxvibro.reproduction import fixed_step

DRIVE = fixed_step.OscillatorParameters(OMEGA, GAMMA, RESTITUTION)


def strobe(states, steps=400):
    """Map (n, 3) states x, x', A over one period with the given number of steps; returns Strobes."""
    return Strobes(*fixed_step.fixed_step_strobe(DRIVE, states, steps, max_impacts=CAP))
