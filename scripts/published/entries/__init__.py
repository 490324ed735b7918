"""The entries of the gallery, in the order of their years."""

from scripts.published.entries import (
    bapat_1983,
    budd_dux_1994,
    dankowicz_schilder_2013,
    den_hartog_1931,
    ghosh_simpson_2025,
    hertz_1882,
    holmes_1982,
    holmes_phase_1982,
    ing_2008,
    lamba_1993,
    li_tan_2011,
    masri_caughey_1966,
    mehta_luck_1990,
    popp_stelter_1990,
    shaw_1986,
    shaw_holmes_1983,
    simpson_ghosh_2026,
)
from scripts.published.entry import PublishedEntry

ENTRIES: tuple[PublishedEntry, ...] = (
    hertz_1882.ENTRY,
    den_hartog_1931.ENTRY,
    masri_caughey_1966.ENTRY,
    holmes_1982.ENTRY,
    holmes_phase_1982.ENTRY,
    bapat_1983.ENTRY,
    shaw_holmes_1983.ENTRY,
    shaw_1986.ENTRY,
    mehta_luck_1990.ENTRY,
    popp_stelter_1990.ENTRY,
    lamba_1993.ENTRY,
    budd_dux_1994.ENTRY,
    ing_2008.ENTRY,
    *li_tan_2011.ENTRIES,
    dankowicz_schilder_2013.ENTRY,
    ghosh_simpson_2025.ENTRY,
    simpson_ghosh_2026.ENTRY,
)
