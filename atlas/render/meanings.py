"""What each kind of picture and each overlay shows, in the words of the command's help."""

KIND_MEANINGS = {
    "exponent": "the largest exponent, on a scale around zero",
    "period": "one colour for each period",
    "impacts": "motions by name, n-p-q: periods, impacts at the upper and the lower stop",
    "symmetry": "periodic motions that are their own mirror image, and those with a twin",
    "regions": "the exact curves of a plane and the motions between them by name, as papers print it",
    "combined": "the period where motion is periodic, the exponent where it is chaotic",
    "error": "error of the exponent",
    "cost": "forcing periods simulated",
    "sticking": "fraction of the time at rest on a stop",
    "attractors": "how many attractors a cell has",
    "share": "the share of initial states that reach the attractor shown, the one of most unless another is chosen",
    "labels": "which branch the attractor shown is on, in colours that persist from cell to cell, by atlas label",
    "basins": "of a plane of initial states: which attractor each start goes to",
    "scalar": "any number of each cell, which --variable names",
    "coexistence": "of one axis: bifurcation diagram of all attractors above their shares",
    "sweep": "of one axis: bifurcation diagram above the largest exponent",
    "spectrum": "of one axis: bifurcation diagram above all exponents",
    "hysteresis": "of one axis: two sweeps together, the other with --against",
}

OVERLAY_MEANINGS = {
    "grazing": "where motion without impact would just touch a stop",
    "boundaries": "borders between regimes",
    "isolines": "lines of equal exponent",
    "curves": "the exact bifurcations and grazes that atlas curves has found in the store",
    "branches": "on a sweep: its orbits, stable and unstable, with their bifurcations",
}
