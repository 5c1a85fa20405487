/* Declarations of Python's stable ABI 3.11, as far as the glue needs it: Python's headers are often not installed. */
#ifndef BELTARM_PYTHON_ABI_H
#define BELTARM_PYTHON_ABI_H

#include <stddef.h>
#include <stdint.h>

#ifdef _WIN32
#define PY_IMPORT extern __declspec(dllimport)
#define PY_EXPORT __declspec(dllexport)
#else
#define PY_IMPORT extern __attribute__((visibility("default")))
#define PY_EXPORT __attribute__((visibility("default")))
#endif

typedef intptr_t Py_ssize_t;
typedef struct PyTypeObject PyTypeObject;
typedef struct PyThreadState PyThreadState;
typedef struct {
    Py_ssize_t ob_refcnt;
    PyTypeObject *ob_type;
} PyObject;

typedef struct {
    void *buf;
    PyObject *obj;
    Py_ssize_t len, itemsize;
    int readonly, ndim;
    char *format;
    Py_ssize_t *shape, *strides, *suboffsets;
    void *internal;
} Py_buffer;

typedef PyObject *(*PyCFunction)(PyObject *, PyObject *);
typedef PyObject *(*PyFastFunction)(PyObject *, PyObject *const *, Py_ssize_t);
typedef PyObject *(*allocfunc)(PyTypeObject *, Py_ssize_t);
typedef void (*freefunc)(void *);
typedef int (*inquiry)(PyObject *);
typedef int (*visitproc)(PyObject *, void *);
typedef int (*traverseproc)(PyObject *, visitproc, void *);
typedef struct {
    const char *ml_name;
    PyCFunction ml_meth;
    int ml_flags;
    const char *ml_doc;
} PyMethodDef;
typedef struct {
    int slot;
    void *value;
} PySlot; /* PyType_Slot and PyModuleDef_Slot */
typedef struct {
    const char *name;
    int basicsize, itemsize;
    unsigned int flags;
    PySlot *slots;
} PyType_Spec;
typedef struct {
    PyObject ob_base;
    PyObject *(*m_init)(void);
    Py_ssize_t m_index;
    PyObject *m_copy;
    const char *m_name, *m_doc;
    Py_ssize_t m_size;
    PyMethodDef *m_methods;
    PySlot *m_slots;
    traverseproc m_traverse;
    inquiry m_clear;
    freefunc m_free;
} PyModuleDef;

enum { METH_VARARGS = 0x1, METH_NOARGS = 0x4, METH_O = 0x8, METH_FASTCALL = 0x80 };
enum { PyBUF_FORMAT = 0x4, PyBUF_STRIDES = 0x18 };
enum { Py_mod_exec = 2, Py_tp_alloc = 47, Py_tp_clear = 51, Py_tp_dealloc = 52, Py_tp_methods = 64 };
enum { Py_tp_new = 65, Py_tp_traverse = 71, Py_tp_free = 74 };
#define Py_TPFLAGS_DISALLOW_INSTANTIATION (1u << 7)
#define Py_TPFLAGS_HAVE_GC (1u << 14)
#define Py_TPFLAGS_LONG_SUBCLASS (1u << 24)
#define Py_TPFLAGS_TUPLE_SUBCLASS (1u << 26)
#define Py_TPFLAGS_TYPE_SUBCLASS (1u << 31)

PY_IMPORT PyTypeObject PyBool_Type, PyFloat_Type, PyTuple_Type;
PY_IMPORT PyObject _Py_NoneStruct, _Py_TrueStruct, _Py_FalseStruct;
PY_IMPORT PyObject *PyExc_OverflowError, *PyExc_TypeError, *PyExc_ValueError;
#define Py_TYPE(object) (((PyObject *)(object))->ob_type)
#define Py_None (&_Py_NoneStruct)
#define Py_True (&_Py_TrueStruct)
#define Py_False (&_Py_FalseStruct)

PY_IMPORT void Py_IncRef(PyObject *), Py_DecRef(PyObject *);
PY_IMPORT void *PyMem_Malloc(size_t), *PyMem_Calloc(size_t, size_t);
PY_IMPORT void PyMem_Free(void *);
PY_IMPORT PyThreadState *PyEval_SaveThread(void);
PY_IMPORT void PyEval_RestoreThread(PyThreadState *);
PY_IMPORT int PyArg_ParseTuple(PyObject *, const char *, ...);
PY_IMPORT PyObject *PyErr_Occurred(void), *PyErr_NoMemory(void), *PyErr_Format(PyObject *, const char *, ...);
PY_IMPORT void PyErr_Clear(void), PyErr_SetString(PyObject *, const char *);
PY_IMPORT PyObject *PyBool_FromLong(long), *PyFloat_FromDouble(double), *PyLong_FromLongLong(long long);
PY_IMPORT PyObject *PyLong_FromUnsignedLongLong(unsigned long long);
PY_IMPORT PyObject *PyByteArray_FromStringAndSize(const char *, Py_ssize_t);
PY_IMPORT double PyFloat_AsDouble(PyObject *);
PY_IMPORT Py_ssize_t PyLong_AsSsize_t(PyObject *);
PY_IMPORT long long PyLong_AsLongLongAndOverflow(PyObject *, int *);
PY_IMPORT PyObject *PyTuple_New(Py_ssize_t), *PyTuple_GetItem(PyObject *, Py_ssize_t);
PY_IMPORT Py_ssize_t PyTuple_Size(PyObject *), PyList_Size(PyObject *);
PY_IMPORT int PyTuple_SetItem(PyObject *, Py_ssize_t, PyObject *), PyList_Append(PyObject *, PyObject *);
PY_IMPORT PyObject *PyList_New(Py_ssize_t), *PyList_GetItem(PyObject *, Py_ssize_t);
PY_IMPORT PyObject *PyDict_New(void), *PyDict_Copy(PyObject *);
PY_IMPORT Py_ssize_t PyDict_Size(PyObject *);
PY_IMPORT int PyDict_SetItem(PyObject *, PyObject *, PyObject *);
PY_IMPORT int PyDict_Next(PyObject *, Py_ssize_t *, PyObject **, PyObject **);
PY_IMPORT PyObject *PyUnicode_FromStringAndSize(const char *, Py_ssize_t);
PY_IMPORT void PyUnicode_InternInPlace(PyObject **);
PY_IMPORT PyObject *PyUnicode_FromString(const char *), *PyUnicode_FromFormat(const char *, ...);
PY_IMPORT int PyObject_CheckBuffer(PyObject *), PyObject_GetBuffer(PyObject *, Py_buffer *, int);
PY_IMPORT void PyBuffer_Release(Py_buffer *);
PY_IMPORT PyObject *PyObject_CallObject(PyObject *, PyObject *), *PyObject_CallFunctionObjArgs(PyObject *, ...);
PY_IMPORT PyObject *PyObject_CallMethod(PyObject *, const char *, const char *, ...);
PY_IMPORT PyObject *PyImport_ImportModule(const char *), *PyObject_GetAttrString(PyObject *, const char *);
PY_IMPORT void *PyCapsule_GetPointer(PyObject *, const char *);
PY_IMPORT PyObject *PyCFunction_NewEx(PyMethodDef *, PyObject *, PyObject *);
PY_IMPORT int PyType_IsSubtype(PyTypeObject *, PyTypeObject *);
PY_IMPORT unsigned long PyType_GetFlags(PyTypeObject *);
PY_IMPORT PyObject *PyType_GetName(PyTypeObject *);
PY_IMPORT void *PyType_GetSlot(PyTypeObject *, int);
PY_IMPORT void *PyType_GetModuleState(PyTypeObject *), *PyModule_GetState(PyObject *);
PY_IMPORT PyObject *PyType_FromModuleAndSpec(PyObject *, PyType_Spec *, PyObject *);
PY_IMPORT int PyModule_AddType(PyObject *, PyTypeObject *);
PY_IMPORT PyObject *PyModuleDef_Init(PyModuleDef *);
PY_IMPORT void PyObject_GC_UnTrack(void *);

#endif
