"""Types of C for trees.py, which hatch_build.py compiles."""

cimport cython

cdef unsigned int _ALL_LEAVES, _DE_BRUIJN
cdef int[::1] _PLACES


cdef class Trees:
    cdef public double[::1] first, limit, leaf, scores
    cdef public int[::1] output, leaf_of, of_feature, tree
    cdef public signed char[::1] nan_fails
    cdef public unsigned int[::1] left, reached

    @cython.locals(
        k=Py_ssize_t, t=Py_ssize_t, feature=Py_ssize_t, end=Py_ssize_t, value=double, lowest="unsigned int", place=int
    )
    cpdef evaluate(self, double[::1] row)
