/* Variants of a kernel: what arguments one takes, what it returns, and how its spec is read.
 *
 * One character stands for each thing: d a float, n a whole number, b a bool, 0 None, k the next constant, (...) a
 * tuple whose type is the next constant, a an array, followed by the type of its entries (float64 d, float32 f, int64
 * l, uint64 L, int8 b, uint8 B, bool ?), its number of axes, and its layout: c contiguous, s strided, in capitals if
 * read-only. What is returned is described alike: with L for a whole number without a sign, A, a type and a number of
 * axes for a new array, which the entry allocates, {one,two:...} for a dict with these keys, and o for the last
 * argument itself. */
#ifndef BELTARM_VARIANT_H
#define BELTARM_VARIANT_H

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "python_abi.h"

typedef union {
    double d;
    int64_t n;
    void *p;
} Slot;
typedef const char *(*Entry)(void *const *p, const double *r, const int64_t *n, Slot *out);

typedef struct {
    char kind, type, layout;
    bool strided, readonly;
    int axes;
    Py_ssize_t parent, index; /* the tuple that holds it, or -1, and its place therein */
    Py_ssize_t entries;       /* of a tuple */
    PyObject *constant;
} Node;

typedef struct {
    PyObject head;
    Entry entry;
    Node *nodes;
    char *returns;
    PyObject *constants, *finish;
    PyObject *dict;      /* a dict of results, with its keys alone; NULL without one */
    PyObject **keys;     /* these */
    Py_ssize_t *entries; /* how many each tuple of results has, in the order of the tuples */
    Py_ssize_t count, arguments, arrays, reals, wholes, slots; /* count: of nodes */
    size_t room, kept; /* bytes that a call needs, and those of them that its arguments fill */
    bool allocates;                                            /* whether new arrays are among the results */
} Variant;

/* Arguments and results of a call, in memory of its own */
typedef struct {
    double *r;
    int64_t *n;
    Slot *out;
    Py_buffer *buffers;
    void **p;
    PyObject **tuples; /* at the index of their node */
    PyObject *last;    /* argument */
    Py_ssize_t held;   /* number of buffers that are held */
    Py_ssize_t bound;  /* number of first arguments that were unpacked before, and what they have filled: */
    Py_ssize_t nodes, reals, wholes, arrays;
    bool overflow;
    bool entries; /* whether floats come as arrays of shape (1,) */
} Call;

/* A variant with its first arguments */
typedef struct {
    PyObject head;
    PyObject *variant, *arguments;
    PyObject *like; /* the last argument is a new array like this one in each call; NULL if the call has it */
    Call c;
} Bound;

enum { MAX_DEPTH = 100 /* of tuples in a result */, DONE = -1, OTHER = 0 /* type that kernels do not have */ };

static size_t size_of(char type) { return type == 'd' || type == 'l' || type == 'L' ? 8 : type == 'f' ? 4 : 1; }
static bool is_type(char type) { return type != '\0' && strchr("dfl?bLB", type) != NULL; }
static bool is_digit(char digit) { return digit >= '0' && digit <= '9'; }

/* Read the type, axes and layout of an array; `s` is behind its a. */
static bool read_array(Variant *v, Node *node, const char *s)
{
    if (!is_type(s[0]) || !is_digit(s[1]) || s[2] == '\0' || strchr("csCS", s[2]) == NULL) return false;
    node->type = s[0];
    node->axes = s[1] - '0';
    node->layout = s[2];
    node->strided = s[2] == 's' || s[2] == 'S';
    node->readonly = s[2] == 'C' || s[2] == 'S';
    v->arrays += 1;
    v->wholes += node->strided ? 2 * node->axes : node->axes;
    return true;
}

static bool is_tuple_type(PyObject *type)
{
    return (PyType_GetFlags(Py_TYPE(type)) & Py_TPFLAGS_TYPE_SUBCLASS) != 0 &&
           (PyType_GetFlags((PyTypeObject *)type) & Py_TPFLAGS_TUPLE_SUBCLASS) != 0;
}

/* Read what arguments a variant takes. Returns NULL, or what is wrong. */
static const char *read_arguments(Variant *v, const char *s)
{
    Py_ssize_t constants = PyTuple_Size(v->constants), used = 0, open = -1;
    for (; *s; ++s) {
        if (*s == ')') {
            if (open < 0) return "a bracket is closed that was not opened";
            open = v->nodes[open].parent;
            continue;
        }
        Node *node = &v->nodes[v->count];
        node->kind = *s;
        node->parent = open;
        node->index = open < 0 ? v->arguments++ : v->nodes[open].entries++;
        if (*s == 'k' || *s == '(') {
            if (used == constants) return "there are too few constants";
            node->constant = PyTuple_GetItem(v->constants, used++);
        }
        switch (*s) {
        case 'd': v->reals += 1; break;
        case 'n':
        case 'b': v->wholes += 1; break;
        case '0':
        case 'k': break;
        case '(':
            if (!is_tuple_type(node->constant)) return "the constant of a tuple is not its type";
            open = v->count;
            break;
        case 'a':
            if (!read_array(v, node, s + 1)) return "an array is a type, a number of axes, and a layout";
            s += 3;
            break;
        default: return "a character has no meaning";
        }
        v->count += 1;
    }
    if (open >= 0) return "a bracket is not closed";
    return used < constants ? "there are too many constants" : NULL;
}

/* Read the keys of a dict and its numbers; `s` is behind its bracket. Returns where it ends, or NULL. */
static const char *read_keys(Variant *v, const char *s)
{
    if ((v->dict = PyDict_New()) == NULL) return NULL;
    for (const char *end = s; end[-1] != ':'; s = ++end) {
        while (*end && strchr(",:", *end) == NULL) ++end;
        PyObject *key = *end ? PyUnicode_FromStringAndSize(s, end - s) : NULL;
        if (key) PyUnicode_InternInPlace(&key);
        bool kept = key && PyDict_SetItem(v->dict, key, Py_None) == 0;
        if (key) Py_DecRef(key);
        if (!kept) return NULL;
    }
    Py_ssize_t numbers = (Py_ssize_t)strspn(s, "dnbL");
    v->slots += numbers;
    if (numbers != PyDict_Size(v->dict) || s[numbers] != '}') return NULL;
    if ((v->keys = PyMem_Calloc((size_t)numbers, sizeof(PyObject *))) == NULL) return NULL;
    for (Py_ssize_t k = 0, at = 0; PyDict_Next(v->dict, &at, &v->keys[k], NULL);) ++k;
    return s + numbers;
}

/* Read what a variant returns. Returns NULL, or what is wrong. */
static const char *read_results(Variant *v, const char *s)
{
    Py_ssize_t depth = 0, results = 0, tuples = 0, *held_by[MAX_DEPTH + 1] = {&results};
    for (; *s; ++s) {
        if (*s != ')') ++*held_by[depth];
        switch (*s) {
        case '0': break;
        case 'o':
            if (v->arguments == 0) return "there is no last argument";
            break;
        case 'd':
        case 'n':
        case 'b':
        case 'L': v->slots += 1; break;
        case '(':
            if (++depth > MAX_DEPTH) return "tuples are nested too deeply";
            held_by[depth] = &v->entries[tuples++];
            break;
        case ')':
            if (--depth < 0) return "a bracket is closed that was not opened";
            break;
        case 'A':
            if (!is_type(s[1]) || !is_digit(s[2])) return "a new array is a type and a number of axes";
            v->slots += 1 + s[2] - '0';
            s += 2;
            break;
        case '{':
            if (v->dict) return "there are two dicts";
            if ((s = read_keys(v, s + 1)) == NULL) return "a dict is its keys, a colon, and as many numbers";
            break;
        default: return "a character has no meaning";
        }
    }
    if (depth > 0) return "a bracket is not closed";
    return results == 1 ? NULL : "there is not one result";
}

static char *copy_of(const char *text)
{
    size_t size = strlen(text) + 1;
    char *copy = PyMem_Malloc(size);
    return copy ? memcpy(copy, text, size) : NULL;
}

/* Set up a new variant. Returns whether it could be; if not, there is an error. */
static bool set_up(Variant *v, const char *spec, const char *returns)
{
    const char *wrong;
    v->nodes = PyMem_Calloc(strlen(spec) + 1, sizeof(Node)); /* each node has a character or more */
    v->returns = copy_of(returns);
    v->entries = PyMem_Calloc(strlen(returns) + 1, sizeof(Py_ssize_t));
    if (v->nodes == NULL || v->returns == NULL || v->entries == NULL) {
        PyErr_NoMemory();
        return false;
    }
    if ((wrong = read_arguments(v, spec)) != NULL) {
        PyErr_Format(PyExc_ValueError, "spec %s: %s", spec, wrong);
        return false;
    }
    if ((wrong = read_results(v, returns)) != NULL) {
        PyErr_Format(PyExc_ValueError, "result %s: %s", returns, wrong);
        return false;
    }
    char *keys = strchr(v->returns, '{');
    if (keys) memmove(keys + 1, strchr(keys, ':') + 1, strlen(strchr(keys, ':'))); /* from now on a result is one letter */
    v->allocates = strchr(v->returns, 'A') != NULL;
    v->kept = sizeof(double) * (size_t)(v->reals + v->wholes) + sizeof(void *) * (size_t)(v->arrays + v->count);
    v->room = v->kept + sizeof(Slot) * (size_t)v->slots + sizeof(Py_buffer) * (size_t)v->arrays;
    return true;
}

#endif
