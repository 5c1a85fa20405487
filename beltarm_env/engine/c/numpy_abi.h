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
typedef PyObject *(*NewFromDescr)(PyTypeObject *, PyObject *, int, const Py_ssize_t *, const Py_ssize_t *, void *, int,
                                  PyObject *);
enum { ABI_VERSION = 0, NEW_FROM_DESCR = 94 }; /* places in NumPy's table of functions, which NumPy 2 has */

/* An array, as NumPy or a buffer shows it */
typedef struct {
    void *data;
    const Py_ssize_t *shape, *strides;
    int axes;
    bool readonly;
    char type; /* OTHER if kernels do not have it */
} View;

static PyTypeObject *array_type; /* NumPy's, once its layout is known to be this one */
static NewFromDescr new_from_descr;

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

/* Make a new array of the type and shape of another, whose layout is C's; what it holds is not set. */
static PyObject *array_like(PyObject *object)
{
    const ArrayFields *a = (const ArrayFields *)object;
    if (Py_TYPE(object) != array_type || new_from_descr == NULL) return PyObject_CallMethod(object, "copy", NULL);
    Py_IncRef(a->descr); /* which is taken */
    return new_from_descr(array_type, a->descr, a->nd, a->dimensions, NULL, NULL, 0, NULL);
}

/* Find what makes arrays, where extensions find it that are compiled with NumPy's headers. */
static NewFromDescr find_new_from_descr(void)
{
    PyObject *module = PyImport_ImportModule("numpy._core._multiarray_umath");
    PyObject *capsule = module ? PyObject_GetAttrString(module, "_ARRAY_API") : NULL;
    void **functions = capsule ? PyCapsule_GetPointer(capsule, NULL) : NULL;
    if (functions == NULL) PyErr_Clear();
    if (capsule) Py_DecRef(capsule);
    if (module) Py_DecRef(module);
    bool known = functions != NULL && ((unsigned (*)(void))functions[ABI_VERSION])() >> 24 == 2;
    return known ? (NewFromDescr)functions[NEW_FROM_DESCR] : NULL;
}

#endif
