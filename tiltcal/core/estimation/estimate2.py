"""The one estimator: from positions to coefficients, jointly over all sensors and channels of a fixture."""

from __future__ import annotations

from math import degrees

import numpy as np

from tiltcal.core.estimation.budget import budgets
from tiltcal.core.estimation.design import require_sound
from tiltcal.core.estimation.equations import ADC, JIG, THERMOMETER, Equations
from tiltcal.core.estimation.estimate import NO_FREEDOM, Estimate, _coefficients
from tiltcal.core.estimation.solve import solved, with_estimated


def estimate_jointly(sensors):
    require_sound(sensors)
    design = sensors[0].design
    equations = Equations(sensors)
    solution = solved(equations, equations.stated)
    dof, estimated = solution.dof, {}
    chi_square = solution.chi_square if dof else None
    if dof > 0:
        if equations.noise_unknown:
            source = ADC
        elif design.jig is None:
            source = JIG
        elif (
            design.thermometer is None
            and solution.chi_square > dof
            and equations.errors[THERMOMETER].stop > equations.errors[THERMOMETER].start
        ):
            source = THERMOMETER
        else:
            source = None
        if source:
            solution, estimated[source] = with_estimated(solution, source)
    from scipy.special import chdtrc

    p = None if chi_square is None else float(chdtrc(dof, chi_square))
    residuals = equations.unexplained(solution.z)
    out = []
    row = 0
    for number, (sensor, budget) in enumerate(zip(sensors, budgets(solution, estimated), strict=True)):
        own = [c for c in equations.channels if c.sensor == number]
        theta = np.concatenate([solution.z[c.coefficients] for c in own])
        count = len(own) * len(sensor.observations)
        out.append(
            Estimate(
                coefficients=_coefficients(sensor, theta),
                names=sensor.design.names,
                budget=budget,
                positions=tuple(o.position for o in sensor.observations),
                residuals=residuals[row : row + count].reshape(len(own), -1).T,
                dof=dof,
                chi_square=chi_square,
                p=p,
                stated=design.jig is not None,
                estimated_jig=degrees(solution.errors.jig) if design.jig is None else None,
                notes=() if dof else (NO_FREEDOM,),
            )
        )
        row += count
    return tuple(out)
