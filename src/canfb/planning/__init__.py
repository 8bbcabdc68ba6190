"""What a bit rate, a SYNC rate, an encoder and a motion allow, before there is a machine.

Pure arithmetic over a module, its interface and a simulated motion::

    traffic      the frames of a node: how long, how often, bound to SYNC or not
    bus_load     all frames of a bus: worst-case load, the largest SYNC rate, what delays a SYNC
    situation    the input of a plan; stated: from a configuration and options; planned_module: one module
    adc_pdos     the RPDOs that bring the samples; phase_errors: what the encoder adds to a residual
    budget       what the residual limit of a module is used up by, and the limits that follow
    jerk_budget  the same with third-order prediction
    detection    which errors of the count cannot pass at a residual limit (docs/legal-motion.md)
    plan         all of it together: margins, and whether they hold; remedies: what to change first
    planned_config  the configuration, each module with a node-ID
    plan_lines   for people; plan_figures: for programs
"""
