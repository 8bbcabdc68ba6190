"""What a bit rate, a SYNC rate, an encoder and a motion allow, before there is a machine.

Pure arithmetic over a module, its interface and a simulated motion::

    traffic         the frames of a bus: their load at worst, the largest SYNC rate, delay of a SYNC
    planned_module  one module by its objects, and other layouts of the RPDOs that bring its samples
    plan_input      the input of a plan, from a configuration and options
    budget          what the residual limit of a module is used up by, and the limits that follow
    plan            margins, whether they hold, and which errors of the count cannot pass
    coverage        how much of the faults of an encoder the limits detect
    hints           the changes that a plan proposes, each tried on it
    plan_rows       the plan for people and for programs
"""
