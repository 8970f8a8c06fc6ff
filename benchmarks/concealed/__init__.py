"""Recordings with concealed causes, and methods that look for them: who sees, names and models what a model leaves out.

A case has the nominal model as a callable, a recording, draws of what the recording would be if nothing were missing, and
a menu of causes. Two generators that share no code with torchlc make the recordings: ``examples/reference`` and Mitsuba 3.
Every method is one file in ``methods``.
"""
