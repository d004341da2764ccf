"""Types of C for trees.py, which hatch_build.py compiles."""

cimport cython


cdef class Trees:
    cdef public double[::1] first, value, scores
    cdef public long long[::1] root, output, feature, left, right, missing_left

    @cython.locals(k=Py_ssize_t, t=Py_ssize_t, node=Py_ssize_t, feature=Py_ssize_t, value=double)
    cpdef evaluate(self, double[::1] row)
