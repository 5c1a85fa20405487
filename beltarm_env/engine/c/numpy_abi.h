/* NumPy's arrays, read as extensions read them that are compiled with its headers: their layout is part of its binary
 * interface. To read it takes a tenth of the time of a buffer. It is used once it has been compared with buffers. */
#ifndef BELTARM_NUMPY_ABI_H
#define BELTARM_NUMPY_ABI_H

#include <stdbool.h>
#include <string.h>

#include "variant.h"

typedef struct {
    PyObject head;
    void *data;
    int nd;
    Py_ssize_t *dimensions, *strides;
    PyObject *base, *descr;
    int flags;
} ArrayFields;
typedef struct {
    PyObject head;
    PyTypeObject *typeobj;
    char kind, type, byteorder, unused;
    int type_num;
} DescrFields;
enum { NPY_ARRAY_WRITEABLE = 0x400 };

/* An array, as NumPy or a buffer shows it */
typedef struct {
    void *data;
    const Py_ssize_t *shape, *strides;
    int axes;
    bool readonly;
    char type; /* OTHER if kernels do not have it */
} View;

static PyTypeObject *array_type; /* NumPy's, once its layout is known to be this one */

static char type_of_descr(const DescrFields *descr)
{
    if (descr->byteorder != '=' && descr->byteorder != '|') return OTHER;
    switch (descr->type) {
    case 'q': return 'l';
    case 'Q': return 'L';
    case 'l':
    case 'L': return sizeof(long) == 8 ? descr->type : OTHER;
    default: return is_type(descr->type) ? descr->type : OTHER;
    }
}

static View read_array_fields(PyObject *object)
{
    const ArrayFields *a = (const ArrayFields *)object;
    bool readonly = (a->flags & NPY_ARRAY_WRITEABLE) == 0;
    return (View){a->data, a->dimensions, a->strides, a->nd, readonly, type_of_descr((const DescrFields *)a->descr)};
}

static bool view_of_array(PyObject *object, View *view)
{
    if (Py_TYPE(object) != array_type) return false;
    *view = read_array_fields(object);
    return true;
}

#endif
