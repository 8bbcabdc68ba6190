"""``canfb commission``: limits of the supervision from a machine in its duty.

From samples to limits that are written, watched and saved::

    commission_run      from the first sample to the last file
    observation         samples of the duty, followed by the chain of the module; or why they cannot be
    machine_figures     motion, signal and noise of the machine by these samples
    limit_choice        the limits that follow, each with its reason
    commission_summary  figures for people and programs; commission_page: the page
"""
