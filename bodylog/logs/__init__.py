"""Recorded logs in and out: containers -> columns -> recording one way, messages -> annotate the other."""
