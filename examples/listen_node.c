/* libtactiled in Node: an addon whose `listen(endpoint, callback)` calls back from the event loop of Node, with
 * (state, kind) for each slip, and with ("stale", reason) when touch must not be trusted.
 *
 *     cc -shared -fPIC listen_node.c -I/usr/include/node $(pkg-config --cflags --libs libtactiled) \
 *         -o listen.node
 */
#include <math.h>
#include <node_api.h>
#include <stdio.h>
#include <stdlib.h>
#include <tactiled.h>
#include <uv.h>

struct listener {
    napi_env env;
    napi_ref callback;
    tactiled_client *events;
    uv_poll_t poll;
};

static void call_back(struct listener *listener, const char *first, const char *second)
{
    napi_value global, callback, arguments[2];
    napi_get_global(listener->env, &global);
    napi_get_reference_value(listener->env, listener->callback, &callback);
    napi_create_string_utf8(listener->env, first, NAPI_AUTO_LENGTH, &arguments[0]);
    napi_create_string_utf8(listener->env, second, NAPI_AUTO_LENGTH, &arguments[1]);
    napi_make_callback(listener->env, NULL, global, callback, 2, arguments, NULL);
}

static void take_items(uv_poll_t *poll, int status, int events)
{
    struct listener *listener = poll->data;
    tactiled_client *client = listener->events;
    napi_handle_scope scope;
    int kind;
    (void)status, (void)events;
    napi_open_handle_scope(listener->env, &scope);
    while ((kind = tactiled_next(client, 0.0)) > TACTILED_NONE) { /* until then, the descriptor stays silent */
        double is_valid = 0.0;
        if (kind == TACTILED_STALE)
            call_back(listener, "stale", tactiled_reason(client));
        if (kind == TACTILED_MESSAGE && tactiled_number(client, "valid", &is_valid) == 0 && is_valid != 0.0 &&
            tactiled_is_fresh(client) && fabs(tactiled_age_s(client)) < 0.2) {
            char state[16];
            snprintf(state, sizeof state, "%s", tactiled_text(client, "state"));
            call_back(listener, state, tactiled_text(client, "kind"));
        }
    }
    napi_close_handle_scope(listener->env, scope);
}

static napi_value open_listener(napi_env env, napi_callback_info info)
{
    char endpoint[256] = "";
    size_t count = 2;
    napi_value arguments[2];
    struct listener *listener = calloc(1, sizeof *listener); /* until the program ends */
    uv_loop_t *loop;
    napi_get_cb_info(env, info, &count, arguments, NULL, NULL);
    napi_get_value_string_utf8(env, arguments[0], endpoint, sizeof endpoint, NULL);
    if (!listener || !*endpoint || !(listener->events = tactiled_open(endpoint, "slip", NULL, NULL))) {
        napi_throw_error(env, NULL, *endpoint ? tactiled_error() : "an endpoint is wanted");
        free(listener);
        return NULL;
    }
    listener->env = env;
    listener->poll.data = listener;
    napi_create_reference(env, arguments[1], 1, &listener->callback);
    napi_get_uv_event_loop(env, &loop);
    uv_poll_init(loop, &listener->poll, tactiled_fd(listener->events));
    uv_poll_start(&listener->poll, UV_READABLE, take_items);
    take_items(&listener->poll, 0, 0);
    return NULL;
}

NAPI_MODULE_INIT()
{
    napi_value function;
    napi_create_function(env, "listen", NAPI_AUTO_LENGTH, open_listener, NULL, &function);
    napi_set_named_property(env, exports, "listen", function);
    return exports;
}
