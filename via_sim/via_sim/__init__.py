"""Simulation of single joints and of robots.

catalogue one file per effect: parameters, slots, terms, starts of fits, words
joint     physics of one joint, compiled: parameter row, torques, drives, encoders, integrator, measurements
effects   effects as data at a location of a joint, effects files
plants    a device with effects as a parameter row;  sensors  its sensors
simulate  runs of one joint;  lockstep  many variants of a joint at once
robots    arms with contacts, the hopper
nodes     the simulators as ROS nodes
"""
