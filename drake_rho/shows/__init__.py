"""Shows: fleets that fly from pads through formations and back.

A `Show` lists pads and formations. `plan_show` assigns vehicles to places, plans every transition,
and returns one plan from the take-off to the landing, which `verify` judges as any other.
"""

from drake_rho.shows import formations as formations
