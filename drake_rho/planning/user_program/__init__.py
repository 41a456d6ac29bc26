"""One convex program with everything written out, for users to change and solve.

`program` puts it together, `constraints` has a function for each equation of the paper, `values`
the motion as affine functions of the accelerations, and `conic` convex sets as rows and cones.
"""
