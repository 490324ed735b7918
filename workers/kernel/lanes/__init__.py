"""The stroboscopic map of many cells at a time: loops over lanes, one cell each, that compile to vector instructions.

Each round evaluates every lane once, at the time that its last step led to, and either takes its next certified step or
takes it through the impact or section that it has reached. A lane that is through takes the next cell of the queue.
What is rare (rest on a stop, the end of chatter, a march of many steps) ends a lane at its last section, from which the
scalar kernels go on.
"""
