"""Types of C for trees.py, which hatch_build.py compiles."""

cimport cython


cdef class Trees:
    cdef public double[::1] first, value, scores
    cdef public long long[::1] root, output
    cdef public int[::1] links

    @cython.locals(k=Py_ssize_t, t=Py_ssize_t, node=Py_ssize_t, link=int, value=double, goes_left=bint)
    cpdef evaluate(self, double[::1] row)
