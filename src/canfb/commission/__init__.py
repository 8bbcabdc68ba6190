"""``canfb commission``: limits of the supervision from the duty of a machine."""
