"""Repairs of reports exported to other simulators: is the gap in MuJoCo that of the report, do other readers load them?"""
