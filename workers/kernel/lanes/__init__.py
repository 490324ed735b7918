"""The stroboscopic map of many cells at once: loops over lanes, one cell each, that compile to vector instructions.

Each round evaluates every lane once, at the time of its last step, then takes either its next certified step or the
impact or section that it has reached. A lane whose cell has finished takes the next cell of the queue. Rare work (rest
on a stop, the end of chatter, a march of many steps) ends a lane at its last section; the scalar kernels continue.
"""
