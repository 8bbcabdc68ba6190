"""``canfb commission``: limits of the supervision, measured on a machine in its duty cycle."""
