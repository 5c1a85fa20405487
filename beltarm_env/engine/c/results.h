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

/* Fill a copy of the prepared dict, which need not grow. */
static PyObject *new_dict(PyObject *keys, const char **s, const Slot **out)
{
    PyObject *dict = PyDict_Copy(keys), *key, *value;
    Py_ssize_t at = 0;
    while (dict && PyDict_Next(keys, &at, &key, NULL)) {
        value = new_number(*(*s)++, (*out)++);
        if (value == NULL || PyDict_SetItem(dict, key, value) != 0) {
            Py_DecRef(dict);
            dict = NULL;
        }
        if (value) Py_DecRef(value);
    }
    ++*s;
    return dict;
}

/* Make Python's object of a result, and go on to what is behind it. */
static PyObject *make(const Variant *v, const char **s, const Slot **out)
{
    const char *at = *s;
    const Slot *slot = *out;
    *s = behind(at);
    if (*at == '(') {
        Py_ssize_t entries = 0;
        int depth = 0;
        for (const char *next = *s; depth > 0 || *next != ')'; next = behind(next)) {
            if (closes(*next)) --depth;
            else if (depth == 0) ++entries;
            if (opens(*next)) ++depth;
        }
        PyObject *tuple = PyTuple_New(entries);
        for (Py_ssize_t k = 0; tuple && k < entries; ++k) {
            PyObject *entry = make(v, s, out);
            if (entry == NULL || PyTuple_SetItem(tuple, k, entry) != 0) {
                Py_DecRef(tuple);
                return NULL;
            }
        }
        ++*s;
        return tuple;
    }
    if (*at == '0') {
        Py_IncRef(Py_None);
        return Py_None;
    }
    if (*at == '{') return new_dict(v->dict, s, out);
    *out += *at == 'A' ? 1 + (at[2] - '0') : 1;
    return *at == 'A' ? new_array(at, slot) : new_number(*at, slot);
}

/* Free the memory that a kernel has allocated for results. */
static void free_new_arrays(const Variant *v, const Slot *out)
{
    for (const char *s = v->returns; v->allocates && *s; s = behind(s)) {
        if (*s == 'A') free(out->p);
        out += *s == 'A' ? 1 + (s[2] - '0') : opens(*s) || closes(*s) || *s == '0' ? 0 : 1;
    }
}

static PyObject *result_of(const Variant *v, const Slot *out)
{
    const char *s = v->returns;
    const Slot *next = out;
    PyObject *result = make(v, &s, &next);
    free_new_arrays(v, out);
    if (result == NULL || v->finish == NULL) return result;
    PyObject *finished = PyObject_CallFunctionObjArgs(v->finish, result, NULL);
    Py_DecRef(result);
    return finished;
}

#endif
