"""The stroboscopic map of many cells at once, in loops that compile to vector instructions.

The loops run over lanes: slots, each of which holds one cell at a time. Each round evaluates the gap coordinate of
every lane once, at the time of its last step. The lane then takes its next certified step, or passes the impact or
section (end of the period) that it has reached. A lane whose cell has finished takes the next cell of the queue. Rare
work ends a lane at its last section, and the kernels of one cell continue. Such work is motion that sticks on a stop,
the end of chatter, or a search of many steps.
"""
