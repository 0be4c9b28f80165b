"""References for the tests: ball arithmetic, 80-bit floats, closed forms. They share nothing with jaxvibro."""
