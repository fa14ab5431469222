"""Pairs of accelerometers on a rotary stage: their scale factors matched, their misalignment compensated.

``model`` has the matched sum with its p and q, ``matching`` finds both in a record and ``online`` sample by sample,
``compensation`` applies them. ``encoder``, ``spin``, ``sectors`` and ``demodulate`` follow the turning of the stage and
take the components at it out of the readings; ``spectrum`` shows what is left.
"""
