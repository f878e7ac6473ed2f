"""The tables, figures and claims of the five papers, each with the rows that show its state."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """
    One table, figure or claim of a paper.

    rows is a regular expression of the rows that show it, picture a part of the name of its
    picture. state is what holding rows and a drawn picture mean: reproduced, better, differs or
    cannot be, the last two with a reason in why.
    """

    item: str
    says: str
    rows: str = ''
    picture: str = ''
    state: str = 'reproduced'
    why: str = ''


@dataclass(frozen=True)
class Paper:
    """A paper, the campaigns that repeat it and its claims."""

    name: str
    source: str
    campaigns: tuple[str, ...]
    claims: tuple[Claim, ...]


PAPERS: tuple[Paper, ...] = (
    Paper('C', '', ('extended-grid',), ()),
)
