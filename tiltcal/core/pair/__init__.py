"""Pairs of accelerometers on a rotary stage: their scale factors matched, their misalignment compensated.

``stage`` follows the angle of the stage, by its encoder or without one, and ``demodulate`` takes the components at the
turning out of the readings. ``matching`` finds p and q of the matched sum (``model``) in a record, ``online`` turn by
turn, and ``compensation`` applies them.
"""
