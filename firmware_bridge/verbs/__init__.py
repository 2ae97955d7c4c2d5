"""The actions of ``apex arm``, one module each."""
