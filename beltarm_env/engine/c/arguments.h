/* Arguments of a call: whether a variant takes them, what of them its entry gets, and why it does not take them. */
#ifndef BELTARM_ARGUMENTS_H
#define BELTARM_ARGUMENTS_H

#include "numpy_abi.h"
#include "variant.h"

/* ---- Arrays ---- */

/* Read what an exporter says of its type; `size` is that of an entry. */
static char type_of(const char *format, Py_ssize_t size)
{
    if (*format == '@' || *format == '=') ++format;
    char type = *format == 'q' ? 'l' : *format == 'Q' ? 'L' : *format;
    return is_type(type) && format[1] == '\0' && (size_t)size == size_of(type) ? type : OTHER;
}

static View view_of_buffer(const Py_buffer *b)
{
    const char *format = b->format ? b->format : "B";
    return (View){b->buf, b->shape, b->strides, b->ndim, b->readonly != 0, type_of(format, b->itemsize)};
}

/* As NumPy has it: strides of axes with one entry do not matter, and none do where there are no entries. */
static bool contiguous(const View *view)
{
    Py_ssize_t stride = (Py_ssize_t)size_of(view->type);
    bool dense = true;
    for (int k = view->axes - 1; k >= 0; --k) {
        if (view->shape[k] == 0) return true;
        if (view->shape[k] != 1 && view->strides[k] != stride) dense = false;
        stride *= view->shape[k];
    }
    return dense;
}

static bool aligned(const View *view) { return (uintptr_t)view->data % size_of(view->type) == 0; }

static bool fits(const Node *node, const View *view)
{
    Py_ssize_t size = (Py_ssize_t)size_of(node->type);
    if (view->type != node->type || view->axes != node->axes || view->readonly != node->readonly) return false;
    if (contiguous(view) == node->strided || !aligned(view)) return false;
    if (view->axes == 0 && view->readonly) return false; /* NumPy's scalars look like this */
    for (int k = 0; node->strided && k < view->axes; ++k) {
        if (view->strides[k] % size != 0) return false;
    }
    return true;
}

/* Look at an array; `b` is held then, if NumPy's own memory of it could not be read. Returns whether it is one. */
static bool look_at(PyObject *object, Py_buffer *b, View *view, bool *held)
{
    *held = false;
    if (view_of_array(object, view)) return true;
    if (!PyObject_CheckBuffer(object)) return false;
    if (PyObject_GetBuffer(object, b, PyBUF_STRIDES | PyBUF_FORMAT) != 0) {
        PyErr_Clear(); /* of entries that are no numbers */
        return false;
    }
    *held = true;
    *view = view_of_buffer(b);
    return true;
}

/* Tell whether NumPy's memory of an array shows what its buffer shows. */
static bool agree(PyObject *array, const Py_buffer *b)
{
    const ArrayFields *fields = (const ArrayFields *)array;
    if (fields->data != b->buf || fields->nd != b->ndim) return false; /* then the rest can be looked at */
    View seen = read_array_fields(array), shown = view_of_buffer(b);
    bool same = seen.readonly == shown.readonly && seen.type == shown.type;
    for (int k = 0; same && k < seen.axes; ++k) same = seen.shape[k] == shown.shape[k];
    same = same && contiguous(&seen) == contiguous(&shown);
    for (int k = 0; same && !contiguous(&seen) && k < seen.axes; ++k) same = seen.strides[k] == shown.strides[k];
    return same;
}

static bool take_array(const Node *node, PyObject *object, Call *c, void **p, int64_t **n)
{
    Py_buffer *b = &c->buffers[c->held];
    View view;
    bool held;
    if (!look_at(object, b, &view, &held)) return false;
    if (!fits(node, &view)) {
        if (held) PyBuffer_Release(b);
        return false;
    }
    c->held += held;
    *p = view.data;
    for (int k = 0; k < view.axes; ++k) *(*n)++ = view.shape[k];
    for (int k = 0; node->strided && k < view.axes; ++k) *(*n)++ = view.strides[k] / (Py_ssize_t)size_of(node->type);
    return true;
}

static void release_arrays(Call *c)
{
    while (c->held > 0) PyBuffer_Release(&c->buffers[--c->held]);
}

/* ---- All arguments ---- */

static bool is_float(PyTypeObject *type) { return type == &PyFloat_Type || PyType_IsSubtype(type, &PyFloat_Type); }
static bool is_whole(PyTypeObject *type)
{
    return (PyType_GetFlags(type) & Py_TPFLAGS_LONG_SUBCLASS) != 0 && type != &PyBool_Type;
}

/* Read the entry of an array of floats of shape (1,), as actions are. */
static bool take_entry(PyObject *object, double *r)
{
    View view;
    if (!view_of_array(object, &view) || view.axes != 1 || view.shape[0] != 1 || !aligned(&view)) return false;
    if (view.type == 'f') *r = *(const float *)view.data;
    if (view.type == 'd') *r = *(const double *)view.data;
    return view.type == 'f' || view.type == 'd';
}

/* The object that a node describes; `arguments` are those behind the bound ones. */
static PyObject *object_of(const Call *c, const Node *node, PyObject *const *arguments)
{
    return node->parent < 0 ? arguments[node->index - c->bound] : PyTuple_GetItem(c->tuples[node->parent], node->index);
}

/* Unpack further arguments. Returns the index of the node that does not fit, or DONE. */
static Py_ssize_t unpack(const Variant *v, Call *c, PyObject *const *arguments, Py_ssize_t count)
{
    double *r = c->r + c->reals;
    int64_t *n = c->n + c->wholes;
    void **p = c->p + c->arrays;
    Py_ssize_t i = c->nodes;
    for (; i < v->count; ++i) {
        const Node *node = &v->nodes[i];
        if (node->parent < 0 && node->index == c->bound + count) break;
        PyObject *o = object_of(c, node, arguments);
        bool fit = true;
        switch (node->kind) {
        case 'd':
            if (c->entries) fit = take_entry(o, r++);
            else if ((fit = is_float(Py_TYPE(o)))) *r++ = PyFloat_AsDouble(o);
            break;
        case 'n':
            if ((fit = is_whole(Py_TYPE(o)))) {
                int overflow;
                *n++ = PyLong_AsLongLongAndOverflow(o, &overflow);
                c->overflow |= overflow != 0;
            }
            break;
        case 'b':
            fit = o == Py_True || o == Py_False;
            *n++ = o == Py_True;
            break;
        case '0': fit = o == Py_None; break;
        case 'k': fit = o == node->constant; break;
        case '(':
            fit = Py_TYPE(o) == (PyTypeObject *)node->constant && PyTuple_Size(o) == node->entries;
            c->tuples[i] = o;
            break;
        default: fit = take_array(node, o, c, p++, &n); break;
        }
        if (!fit) return i;
    }
    c->nodes = i;
    c->reals = r - c->r;
    c->wholes = n - c->n;
    c->arrays = p - c->p;
    return DONE;
}

/* ---- What does not fit ---- */

static const char *name_of(char type)
{
    switch (type) {
    case 'd': return "float64";
    case 'f': return "float32";
    case 'l': return "int64";
    case 'L': return "uint64";
    case 'b': return "int8";
    case 'B': return "uint8";
    case '?': return "bool";
    default: return "of another type";
    }
}

static PyObject *expected(const Node *node)
{
    switch (node->kind) {
    case 'd': return PyUnicode_FromString("a float");
    case 'n': return PyUnicode_FromString("a whole number");
    case 'b': return PyUnicode_FromString("True or False");
    case '0': return PyUnicode_FromString("None");
    case 'k': return PyUnicode_FromFormat("the object %R", node->constant);
    case '(': return PyUnicode_FromFormat("%R with %zd entries", node->constant, node->entries);
    default:
        return PyUnicode_FromFormat("an array (%s, axes %d, %s, %s)", name_of(node->type), node->axes,
                                    node->strided ? "not contiguous" : "contiguous",
                                    node->readonly ? "read-only" : "writable");
    }
}

static PyObject *given(const Node *node, PyObject *object)
{
    Py_buffer b;
    View view;
    bool held;
    PyObject *name = PyType_GetName(Py_TYPE(object)), *text;
    if (name == NULL || node->kind != 'a' || !look_at(object, &b, &view, &held)) return name;
    bool other = view.type == OTHER;
    text = PyUnicode_FromFormat("%U (%s, axes %d, %s, %s)", name, name_of(view.type), view.axes,
                                other || (contiguous(&view) && aligned(&view)) ? "contiguous"
                                : aligned(&view)                               ? "not contiguous"
                                                                               : "not aligned",
                                view.readonly ? "read-only" : "writable");
    if (held) PyBuffer_Release(&b);
    Py_DecRef(name);
    return text;
}

/* Say which argument does not fit: that of a node, or of no node if their number is wrong. Returns NULL. */
static PyObject *refuse(const Variant *v, const Call *c, Py_ssize_t failed, PyObject *const *arguments,
                        Py_ssize_t count)
{
    if (failed == v->count) {
        return PyErr_Format(PyExc_TypeError, "%zd arguments are expected, not %zd", v->arguments, c->bound + count);
    }
    const Node *node = &v->nodes[failed], *outer = node;
    PyObject *place = PyUnicode_FromString(""), *want = expected(node);
    PyObject *have = given(node, object_of(c, node, arguments));
    for (; place && outer->parent >= 0; outer = &v->nodes[outer->parent]) {
        PyObject *longer = PyUnicode_FromFormat("[%zd]%U", outer->index, place);
        Py_DecRef(place);
        place = longer;
    }
    if (place && want && have) {
        PyErr_Format(PyExc_TypeError, "argument %zd%U: %U is expected, not %U", outer->index, place, want, have);
    }
    if (place) Py_DecRef(place);
    if (want) Py_DecRef(want);
    if (have) Py_DecRef(have);
    return NULL;
}

#endif
