"""Types of C for envelope.py, which hatch_build.py compiles."""

cimport cython

cdef extern from "math.h":
    cpdef double sqrt(double x)


cdef class Line:
    cdef public double x0, x1, y0, var00, var01, var11, slope

    cpdef double at(self, double x)
    cpdef double variance_at(self, double x)


cdef class Lines:
    cdef public Line line, free
    cdef public bint is_steep

    cpdef double sd_at(self, double x)


@cython.locals(
    p1=double, q1=double, p2=double, q2=double, over1=double, over2=double, share=double, kept=list
)
cdef list _clip(list polygon, double a, double b, double limit)

@cython.locals(
    p0=double, q0=double, pa=double, qa=double, pb=double, qb=double, ap=double, aq=double, bp=double, bq=double,
    weight=double, sp=double, sq=double, area=double, mp=double, mq=double, mpp=double, mpq=double, mqq=double
)
cdef tuple _moments(list polygon)
