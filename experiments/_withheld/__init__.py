"""Actuators with one withheld effect: written apart from the diagnosis, in other forms, with their own integrator.

form.py      what a form may do, port by port; mechanical, electrical, other, outside: the forms; catalogue.py: names
plant.py     the healthy plant in closed form, and plants with forms in them by fixed Runge-Kutta steps
protocol.py  seven records a set: excitations, sensor;  case.py, scale.py: draw, scale to a gap, keep;  seal.py: labels
score.py     verdict against truth;  cells.py: where, against the force that was missing
"""
