"""The equations on the elements: residual, Jacobian, time integration."""
