"""Pairs of accelerometers on a rotary stage: their scale factors matched, their misalignment compensated.

``model`` has the matched sum with its p and q, ``matching`` finds both in a ``record`` and ``online`` turn by turn,
``compensation`` applies them. ``turns`` follows the stage, ``spin`` does so without an encoder, and ``demodulate``
takes the components at the turning out of the readings.
"""
