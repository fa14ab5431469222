"""The drift of a sensor from a continuous record in one attitude, while its temperature goes up and down."""
