"""The joint estimator: from positions to coefficients, how uncertain they are, and what a plan will determine."""
