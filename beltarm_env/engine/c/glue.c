/* Calls of compiled kernels from Python, without Python's lock: the module _glue.
 *
 * A kernel has variants, compiled functions for arguments of different types. They know nothing of Python. */
#define _POSIX_C_SOURCE 200809L /* threads, signals and clocks */
#include "arguments.h"
#include "level.h"
#include "pool.h"
#include "results.h"

typedef struct {
    PyObject head;
    PyObject *missing, *variants;
    Py_ssize_t last; /* the variant that was called last */
} Kernel;

enum { ON_STACK = 12288, SHARED_ON_STACK = 2048, MAX_SHARES = 4096, MAX_BOUND = 64 };

typedef struct {
    const Variant *v;
    const Call *c;
    int64_t *n;         /* whole numbers of each thread */
    const char **texts; /* what went wrong in each */
} Shared;

static void run_share(void *with, int thread)
{
    const Shared *s = with;
    s->texts[thread] = s->v->entry(s->c->p, s->c->r, s->n + thread * s->v->wholes, s->c->out);
}

static const char *run_shared(const Variant *v, const Call *c, int threads, int helped, void *room)
{
    Shared shared = {v, c, room, NULL};
    const char *text = NULL;
    shared.texts = (const char **)(shared.n + threads * v->wholes);
    for (int k = 0; k < threads; ++k) {
        memcpy(shared.n + k * v->wholes, c->n, sizeof(int64_t) * (size_t)v->wholes);
        shared.n[k * v->wholes] = k;
    }
    share_work(run_share, &shared, threads, helped);
    for (int k = threads - 1; k >= 0; --k) text = shared.texts[k] ? shared.texts[k] : text;
    return text;
}

/* Run a variant whose arguments are unpacked, in several threads if `threads` is not 0. A call with bound arguments is
 * so short that it keeps Python's lock. */
static PyObject *run(const Variant *v, Call *c, int threads)
{
    int64_t small[SHARED_ON_STACK / sizeof(int64_t)];
    size_t need = (size_t)threads * (sizeof(int64_t) * (size_t)v->wholes + sizeof(char *));
    void *room = small;
    const char *text;
    if (c->overflow) {
        release_arrays(c);
        return PyErr_Format(PyExc_OverflowError, "a whole number is beyond 64 bits");
    }
    if (need > sizeof small && (room = PyMem_Malloc(need)) == NULL) {
        release_arrays(c);
        return PyErr_NoMemory();
    }
    int helped = threads > 1 ? ready_helpers(threads) : 0;
    if (v->allocates) memset(c->out, 0, sizeof(Slot) * (size_t)v->slots);
    PyThreadState *state = c->bound > 0 ? NULL : PyEval_SaveThread();
    text = threads > 0 ? run_shared(v, c, threads, helped, room) : v->entry(c->p, c->r, c->n, c->out);
    if (state) PyEval_RestoreThread(state);
    release_arrays(c);
    if (room != small) PyMem_Free(room);
    if (text == NULL) return result_of(v, c);
    free_new_arrays(v, c->out);
    return PyErr_Format(PyExc_ValueError, "%s", text);
}

/* Lay out the memory of a call. */
static void lay_out(const Variant *v, Call *c, void *room)
{
    c->r = room;
    c->n = (int64_t *)(c->r + v->reals);
    c->p = (void **)(c->n + v->wholes);
    c->tuples = (PyObject **)(c->p + v->arrays);
    c->out = (Slot *)(c->tuples + v->count);
    c->buffers = (Py_buffer *)(c->out + v->slots);
}

/* Call a variant if it takes the arguments, behind bound ones if there are some. Returns whether it does; then there is
 * a result or an error. If there is no other variant to be tried, there is an error in any case. */
static bool attempt(const Variant *v, const Call *bound, PyObject *const *arguments, Py_ssize_t count, int threads,
                    bool only, PyObject **result)
{
    double small[ON_STACK / sizeof(double)]; /* small calls need no other memory */
    char *room = v->room <= sizeof small ? (char *)small : PyMem_Malloc(v->room);
    Call c = {0};
    if (room == NULL) {
        *result = PyErr_NoMemory();
        return true;
    }
    if (bound) {
        c = *bound;
        c.held = 0; /* what is held of bound arguments is held on */
        memcpy(room, bound->r, v->kept);
    }
    lay_out(v, &c, room);
    if (count > 0) c.last = arguments[count - 1];
    Py_ssize_t failed = c.bound + count == v->arguments ? unpack(v, &c, arguments, count) : v->count;
    if (failed == DONE) *result = run(v, &c, threads);
    else release_arrays(&c);
    if (failed != DONE && only) *result = refuse(v, &c, failed, arguments, count);
    if (room != (char *)small) PyMem_Free(room);
    return failed == DONE;
}

/* Tell whether a kernel has its parts: the garbage collector may have taken them. If not, there is an error. */
static bool is_whole_kernel(const Kernel *k)
{
    if (k->variants == NULL) PyErr_SetString(PyExc_TypeError, "this kernel is gone");
    return k->variants != NULL;
}

/* Call the variant that takes the arguments. Without one, what is missing is asked; for threads the result is False. */
static PyObject *dispatch(Kernel *k, PyObject *const *arguments, Py_ssize_t count, int threads)
{
    Py_ssize_t many, last = k->last;
    PyObject *result = NULL;
    if (!is_whole_kernel(k)) return NULL;
    many = PyList_Size(k->variants);
    for (Py_ssize_t turn = 0; turn < many; ++turn) {
        Py_ssize_t i = turn == 0 ? last : turn <= last ? turn - 1 : turn;
        const Variant *v = (Variant *)PyList_GetItem(k->variants, i);
        if (threads > 0 && (v->nodes[0].kind != 'n' || strcmp(v->returns, "0") != 0)) continue;
        if (attempt(v, NULL, arguments, count, threads, false, &result)) {
            k->last = i;
            return result;
        }
    }
    if (threads > 0) return PyBool_FromLong(0);
    PyObject *tuple = PyTuple_New(count);
    for (Py_ssize_t i = 0; tuple && i < count; ++i) {
        Py_IncRef(arguments[i]);
        PyTuple_SetItem(tuple, i, arguments[i]);
    }
    if (tuple == NULL) return NULL;
    result = PyObject_CallObject(k->missing, tuple);
    Py_DecRef(tuple);
    return result;
}

static PyObject *kernel_call(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    return dispatch((Kernel *)self, arguments, count, 0);
}

static PyObject *kernel_share(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    Py_ssize_t threads = 0;
    if (count < 1 || !is_whole(Py_TYPE(arguments[0]))) {
        return PyErr_Format(PyExc_TypeError, "the first argument is the number of threads, a whole number");
    }
    threads = PyLong_AsSsize_t(arguments[0]);
    if (threads == -1 && PyErr_Occurred()) return NULL;
    if (threads < 1 || threads > MAX_SHARES) {
        return PyErr_Format(PyExc_ValueError, "%zd threads; there are 1 to %d", threads, MAX_SHARES);
    }
    return dispatch((Kernel *)self, arguments, count, (int)threads);
}

static PyObject *bound_call(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    const Bound *b = (const Bound *)self;
    const Variant *v = (const Variant *)b->variant;
    PyObject *result = NULL, *all[MAX_BOUND];
    if (b->like == NULL || count >= MAX_BOUND) {
        attempt(v, &b->c, arguments, count, 0, true, &result);
        return result;
    }
    for (Py_ssize_t k = 0; k < count; ++k) all[k] = arguments[k];
    if ((all[count] = array_like(b->like)) == NULL) return NULL;
    attempt(v, &b->c, all, count + 1, 0, true, &result);
    Py_DecRef(all[count]);
    return result;
}

/* ---- Types ---- */

typedef struct {
    PyTypeObject *variant, *bound;
} Types;

static const Types *types_of(PyObject *kernel) { return PyType_GetModuleState(Py_TYPE(kernel)); }

static PyObject *new_object(PyTypeObject *type) { return ((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0); }

static void delete_object(PyObject *self)
{
    PyTypeObject *type = Py_TYPE(self);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DecRef((PyObject *)type);
}

static void drop(PyObject **object)
{
    PyObject *dropped = *object;
    *object = NULL;
    if (dropped) Py_DecRef(dropped);
}

static int visit_both(PyObject *self, PyObject *one, PyObject *other, visitproc visit, void *with)
{
    int stop = visit((PyObject *)Py_TYPE(self), with);
    if (stop == 0 && one) stop = visit(one, with);
    return stop == 0 && other ? visit(other, with) : stop;
}

static int variant_traverse(PyObject *self, visitproc visit, void *with)
{
    Variant *v = (Variant *)self;
    return visit_both(self, v->constants, v->finish, visit, with);
}

static int kernel_traverse(PyObject *self, visitproc visit, void *with)
{
    Kernel *k = (Kernel *)self;
    return visit_both(self, k->missing, k->variants, visit, with);
}

static int kernel_clear(PyObject *self)
{
    drop(&((Kernel *)self)->missing);
    drop(&((Kernel *)self)->variants);
    return 0;
}

static void variant_delete(PyObject *self)
{
    Variant *v = (Variant *)self;
    PyObject_GC_UnTrack(self);
    drop(&v->constants);
    drop(&v->finish);
    drop(&v->dict);
    PyMem_Free(v->keys);
    PyMem_Free(v->entries);
    PyMem_Free(v->nodes);
    PyMem_Free(v->returns);
    delete_object(self);
}

static int bound_traverse(PyObject *self, visitproc visit, void *with)
{
    return visit_both(self, ((Bound *)self)->variant, ((Bound *)self)->arguments, visit, with);
}

static void bound_delete(PyObject *self)
{
    Bound *b = (Bound *)self;
    PyObject_GC_UnTrack(self);
    release_arrays(&b->c);
    PyMem_Free(b->c.r);
    drop(&b->arguments);
    drop(&b->variant);
    drop(&b->like);
    delete_object(self);
}

static void kernel_delete(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    kernel_clear(self);
    delete_object(self);
}

static PyObject *kernel_new(PyTypeObject *type, PyObject *arguments, PyObject *keywords)
{
    PyObject *missing;
    (void)keywords;
    if (!PyArg_ParseTuple(arguments, "O:Kernel", &missing)) return NULL;
    Kernel *k = (Kernel *)new_object(type);
    if (k == NULL) return NULL;
    Py_IncRef(missing);
    k->missing = missing;
    if ((k->variants = PyList_New(0)) == NULL) drop((PyObject **)&k);
    return (PyObject *)k;
}

static PyObject *kernel_add(PyObject *self, PyObject *arguments)
{
    unsigned long long address;
    const char *spec, *returns;
    PyObject *constants, *finish, *variants = ((Kernel *)self)->variants;
    if (!is_whole_kernel((Kernel *)self)) return NULL;
    if (!PyArg_ParseTuple(arguments, "KsO!sO:add", &address, &spec, &PyTuple_Type, &constants, &returns, &finish)) {
        return NULL;
    }
    if (address == 0) return PyErr_Format(PyExc_ValueError, "an entry has no address");
    Variant *v = (Variant *)new_object(types_of(self)->variant);
    if (v == NULL) return NULL;
    v->entry = (Entry)(uintptr_t)address;
    Py_IncRef(constants);
    v->constants = constants;
    if (finish != Py_None) {
        Py_IncRef(finish);
        v->finish = finish;
    }
    bool added = set_up(v, spec, returns) && PyList_Append(variants, (PyObject *)v) == 0;
    Py_DecRef((PyObject *)v);
    return added ? PyLong_FromLongLong(PyList_Size(variants) - 1) : NULL;
}

static PyObject *kernel_bind(PyObject *self, PyObject *numbered)
{
    static PyMethodDef call = {"bound", (PyCFunction)(void (*)(void))bound_call, METH_FASTCALL, NULL};
    PyObject *objects[MAX_BOUND], *arguments, *like = Py_None, *function = NULL;
    Py_ssize_t i, failed;
    if (!PyArg_ParseTuple(numbered, "nO!|O:bind", &i, &PyTuple_Type, &arguments, &like)) return NULL;
    if (!is_whole_kernel((Kernel *)self)) return NULL;
    PyObject *variant = PyList_GetItem(((Kernel *)self)->variants, i);
    Bound *b = variant ? (Bound *)new_object(types_of(self)->bound) : NULL;
    if (b == NULL) return NULL;
    const Variant *v = (const Variant *)variant;
    Py_IncRef(b->variant = variant);
    Py_IncRef(b->arguments = arguments);
    if (like != Py_None) Py_IncRef(b->like = like);
    Py_ssize_t count = PyTuple_Size(arguments);
    void *room = PyMem_Calloc(1, v->room);
    if (room == NULL) {
        PyErr_NoMemory();
    } else if (lay_out(v, &b->c, room), count > v->arguments || count > MAX_BOUND) {
        PyErr_Format(PyExc_TypeError, "%zd arguments cannot be bound", count);
    } else {
        for (Py_ssize_t k = 0; k < count; ++k) objects[k] = PyTuple_GetItem(arguments, k);
        failed = unpack(v, &b->c, objects, count);
        if (failed != DONE) refuse(v, &b->c, failed, objects, count);
        else function = PyCFunction_NewEx(&call, (PyObject *)b, NULL);
        b->c.bound = count;
        b->c.entries = b->like != NULL;
        b->c.last = count > 0 ? objects[count - 1] : NULL;
    }
    Py_DecRef((PyObject *)b);
    return function;
}

static PyMethodDef kernel_methods[] = {
    {"add", kernel_add, METH_VARARGS,
     "Add a variant: address, spec, constants, results, and a function of these; returns its number"},
    {"call", (PyCFunction)(void (*)(void))kernel_call, METH_FASTCALL, "Call the variant that takes the arguments"},
    {"share", (PyCFunction)(void (*)(void))kernel_share, METH_FASTCALL,
     "Call in threads, whose number comes first; False without a variant for it"},
    {"bind", kernel_bind, METH_VARARGS, "Return what calls one variant, of a number, behind a tuple of arguments"},
    {NULL, NULL, 0, NULL},
};
static PySlot kernel_slots[] = {
    {Py_tp_new, kernel_new},           {Py_tp_dealloc, kernel_delete},   {Py_tp_traverse, kernel_traverse},
    {Py_tp_clear, kernel_clear},       {Py_tp_methods, kernel_methods},  {0, NULL},
};
static PySlot variant_slots[] = {{Py_tp_dealloc, variant_delete}, {Py_tp_traverse, variant_traverse}, {0, NULL}};
static PySlot bound_slots[] = {{Py_tp_dealloc, bound_delete}, {Py_tp_traverse, bound_traverse}, {0, NULL}};
static PyType_Spec kernel_spec = {"_glue.Kernel", sizeof(Kernel), 0, Py_TPFLAGS_HAVE_GC, kernel_slots};
static PyType_Spec variant_spec = {"_glue.Variant", sizeof(Variant), 0,
                                   Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_DISALLOW_INSTANTIATION, variant_slots};
static PyType_Spec bound_spec = {"_glue.Bound", sizeof(Bound), 0,
                                 Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_DISALLOW_INSTANTIATION, bound_slots};

/* ---- Module ---- */

static PyObject *module_level(PyObject *self, PyObject *unused)
{
    (void)self, (void)unused;
    return PyLong_FromLongLong(level());
}

static int set_up_module(PyObject *module)
{
    PyObject *kernel = PyType_FromModuleAndSpec(module, &kernel_spec, NULL);
    Types *types = PyModule_GetState(module);
    types->variant = (PyTypeObject *)PyType_FromModuleAndSpec(module, &variant_spec, NULL);
    types->bound = (PyTypeObject *)PyType_FromModuleAndSpec(module, &bound_spec, NULL);
    if (kernel == NULL || types->variant == NULL || types->bound == NULL) return -1;
    int added = PyModule_AddType(module, (PyTypeObject *)kernel);
    Py_DecRef(kernel);
    return added;
}

static PyObject *module_know_arrays(PyObject *self, PyObject *arrays)
{
    Py_buffer b;
    PyTypeObject *type = NULL;
    bool same = true;
    Py_ssize_t count = PyTuple_Size(arrays);
    (void)self;
    if (count < 0) return NULL;
    for (Py_ssize_t k = 0; same && k < count; ++k) {
        PyObject *array = PyTuple_GetItem(arrays, k);
        if (PyObject_GetBuffer(array, &b, PyBUF_STRIDES | PyBUF_FORMAT) != 0) return NULL;
        same = (type == NULL || type == Py_TYPE(array)) && agree(array, &b);
        type = Py_TYPE(array);
        PyBuffer_Release(&b);
    }
    if (same && type != NULL) {
        Py_IncRef((PyObject *)type);
        array_type = type;
        new_from_descr = find_new_from_descr();
    }
    return PyBool_FromLong(same && type != NULL);
}

static PyMethodDef functions[] = {
    {"know_arrays", module_know_arrays, METH_O,
     "Read NumPy's arrays without buffers from now on, if that shows the same of a tuple of arrays"},
    {"level", module_level, METH_NOARGS, "Return the level of this x86-64 processor, 1 to 4; 0 for other processors"},
    {NULL, NULL, 0, NULL},
};
static PySlot module_slots[] = {{Py_mod_exec, set_up_module}, {0, NULL}};
static PyModuleDef definition = {
    .ob_base = {1, NULL}, .m_name = "_glue", .m_doc = "Calls of compiled kernels", .m_size = sizeof(Types),
    .m_methods = functions, .m_slots = module_slots,
};

PY_EXPORT PyObject *PyInit__glue(void) { return PyModuleDef_Init(&definition); }
