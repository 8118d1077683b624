"""Transfer of controllers to systems other than those they were evolved in."""

from evaluation.transfer.matrix import transfer

__all__ = ["transfer"]
