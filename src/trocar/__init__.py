"""trocar: the da Vinci Research Kit in Python."""

__version__ = "0.1.0"
