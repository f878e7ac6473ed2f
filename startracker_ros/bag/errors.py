"""What can go wrong with a bag."""


class BagError(OSError):
    """A bag cannot be written or read; the text says which file and why."""


class UnfinishedBagError(BagError):
    """A bag that was never closed: the process was killed or the disk was full."""
