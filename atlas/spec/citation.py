"""What to cite for an atlas, as BibTeX: the software, the method, and the sources of the machine."""

import re

from workers.model.system import System

METHOD = """@article{li-tan-2011,
  author  = {Li, Q.-H. and Tan, J.-Y.},
  title   = {Lyapunov exponent calculation of a two-degree-of-freedom
             vibro-impact system with symmetrical rigid stops},
  journal = {Chinese Physics B},
  volume  = {20},
  pages   = {040505},
  year    = {2011},
  doi     = {10.1088/1674-1056/20/4/040505},
}"""
_METHOD_SOURCE = "Chin. Phys. B 20 (2011) 040505"
_REFERENCE = re.compile(
    r"(?:[a-z ]+: )?(?P<authors>.+?), (?P<journal>[A-Z][^,()]+) (?P<volume>\d+) \((?P<year>\d{4})\) (?P<pages>\w+)"
)


def software(version: str, solver_version: int) -> str:
    """Return the BibTeX entry of the software. It has the solver version, which a paper needs to be reproducible."""
    return f"""@software{{impact-atlas,
  author  = {{{{impact-atlas contributors}}}},
  title   = {{impact-atlas: maps of chaos in vibro-impact oscillators}},
  version = {{{version}}},
  note    = {{solver version {solver_version}}},
}}"""


def sources(system: System) -> list[str]:
    """Return a BibTeX entry for each reference in a system's ``source``; one that is no journal article becomes a note.

    References are separated by semicolons: "Shaw S. W. & Holmes P. J., J. Sound Vib. 90 (1983) 129". The packaged
    systems give no titles of articles. The paper of the method has an entry of its own.
    """
    entries, notes = [], []
    for part in (part.strip() for part in system.source.split(";")):
        if _METHOD_SOURCE in part:
            continue
        match = _REFERENCE.fullmatch(part)
        if match:
            entries.append(_article(match))
        elif part:
            notes.append(part)
    if notes and not entries:
        text = re.sub(r"([&%$#_])", r"\\\1", re.sub(r"[{}\\]", "", "; ".join(notes)))
        return [f"@misc{{{_key(system.name)},\n  note = {{{text}}},\n}}"]
    return entries


def software_version(packages: str) -> str:
    """Return the version of this package from the text of a store's attribute ``software``."""
    match = re.search(r"\bimpact-atlas (\S+?)(?:[,;]|$)", packages)
    return match[1] if match else "unknown"


def bibtex(system: System, version: str, solver_version: int) -> str:
    """Return all BibTeX entries to cite for an atlas of a system.

    system          system of the atlas
    version         version of the package that computed it
    solver_version  its solver version
    """
    return "\n\n".join([software(version, solver_version), METHOD, *sources(system)])


def _article(match: re.Match[str]) -> str:
    names = re.split(r", | & ", match["authors"])
    authors = " and ".join("{}, {}".format(*name.split(" ", 1)) if " " in name else name for name in names)
    return (
        f"@article{{{_key(names[0].split()[0])}-{match['year']},\n"
        f"  author  = {{{authors}}},\n  journal = {{{match['journal']}}},\n  volume  = {{{match['volume']}}},\n"
        f"  pages   = {{{match['pages']}}},\n  year    = {{{match['year']}}},\n}}"
    )


def _key(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "system"
