/* Results of a call: Python's objects of what an entry has written. */
#ifndef BELTARM_RESULTS_H
#define BELTARM_RESULTS_H

#include "variant.h"

static const char *behind(const char *s) { return *s == 'A' ? s + 3 : s + 1; }
static bool opens(char s) { return s == '(' || s == '{'; }
static bool closes(char s) { return s == ')' || s == '}'; }

static PyObject *new_number(char type, const Slot *slot)
{
    switch (type) {
    case 'd': return PyFloat_FromDouble(slot->d);
    case 'n': return PyLong_FromLongLong(slot->n);
    case 'b': return PyBool_FromLong(slot->n != 0);
    default: return PyLong_FromUnsignedLongLong((uint64_t)slot->n);
    }
}

static PyObject *new_array(const char *s, const Slot *out)
{
    Py_ssize_t axes = s[2] - '0', size = (Py_ssize_t)size_of(s[1]);
    PyObject *shape = PyTuple_New(axes), *result = NULL;
    for (Py_ssize_t k = 0; shape && k < axes; ++k) {
        PyObject *length = PyLong_FromLongLong(out[1 + k].n);
        size *= (Py_ssize_t)out[1 + k].n;
        if (length == NULL || PyTuple_SetItem(shape, k, length) != 0) {
            Py_DecRef(shape);
            shape = NULL;
        }
    }
    PyObject *content = shape ? PyByteArray_FromStringAndSize(out->p, size) : NULL;
    if (content && (result = PyTuple_New(2)) != NULL) {
        PyTuple_SetItem(result, 0, content);
        PyTuple_SetItem(result, 1, shape);
        return result;
    }
    if (content) Py_DecRef(content);
    if (shape) Py_DecRef(shape);
    return NULL;
}

/* What of results is still to be made */
typedef struct {
    const char *s;
    const Slot *out;
    const Py_ssize_t *entries; /* of the tuples */
    PyObject *last;            /* argument */
} Results;

/* Fill a copy of the prepared dict, which need not grow. */
static PyObject *new_dict(const Variant *v, Results *left)
{
    PyObject *dict = PyDict_Copy(v->dict);
    for (PyObject **key = v->keys; dict && *left->s != '}'; ++key) {
        PyObject *value = new_number(*left->s++, left->out++);
        if (value == NULL || PyDict_SetItem(dict, *key, value) != 0) {
            Py_DecRef(dict);
            dict = NULL;
        }
        if (value) Py_DecRef(value);
    }
    ++left->s;
    return dict;
}

/* Make Python's object of a result, and go on to what is behind it. */
static PyObject *make(const Variant *v, Results *left)
{
    const char *at = left->s;
    const Slot *slot = left->out;
    left->s = behind(at);
    if (*at == '(') {
        Py_ssize_t entries = *left->entries++;
        PyObject *tuple = PyTuple_New(entries);
        for (Py_ssize_t k = 0; tuple && k < entries; ++k) {
            PyObject *entry = make(v, left);
            if (entry == NULL || PyTuple_SetItem(tuple, k, entry) != 0) {
                Py_DecRef(tuple);
                return NULL;
            }
        }
        ++left->s;
        return tuple;
    }
    if (*at == '0' || *at == 'o') {
        PyObject *same = *at == 'o' ? left->last : Py_None;
        Py_IncRef(same);
        return same;
    }
    if (*at == '{') return new_dict(v, left);
    left->out += *at == 'A' ? 1 + (at[2] - '0') : 1;
    return *at == 'A' ? new_array(at, slot) : new_number(*at, slot);
}

/* Free the memory that a kernel has allocated for results. */
static void free_new_arrays(const Variant *v, const Slot *out)
{
    for (const char *s = v->returns; v->allocates && *s; s = behind(s)) {
        if (*s == 'A') free(out->p);
        out += *s == 'A' ? 1 + (s[2] - '0') : opens(*s) || closes(*s) || *s == '0' || *s == 'o' ? 0 : 1;
    }
}

static PyObject *result_of(const Variant *v, const Call *c)
{
    Results all = {v->returns, c->out, v->entries, c->last};
    PyObject *result = make(v, &all);
    free_new_arrays(v, c->out);
    if (result == NULL || v->finish == NULL) return result;
    PyObject *finished = PyObject_CallFunctionObjArgs(v->finish, result, NULL);
    Py_DecRef(result);
    return finished;
}

#endif
