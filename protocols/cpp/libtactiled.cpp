// The C interface of tactiled.h over the client of C++.
#pragma GCC visibility push(default)  // all else of the library is hidden
#include "tactiled.h"
#pragma GCC visibility pop

#include <charconv>
#include <cmath>
#include <exception>
#include <limits>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tactiled.hpp"

namespace {

thread_local std::string error;

// The result of `call`; `failed` where it throws, with the reason in `error`. No exception may leave C.
template <class Result, class Call> Result guarded(Result failed, const Call& call)
{
    try {
        return call();
    } catch (const std::exception& thrown) {
        error = thrown.what();
        return failed;
    }
}

std::string text_or_empty(const char* text) { return text ? text : ""; }

std::vector<std::string> words_of(const char* text)
{
    std::istringstream stream(text_or_empty(text));
    std::vector<std::string> words;
    for (std::string word; stream >> word;)
        words.push_back(word);
    return words;
}

using Fields = std::vector<std::pair<std::string, std::string>>;

Fields fields_of(const char* text)
{
    std::istringstream stream(text_or_empty(text));
    Fields fields;
    for (std::string line; std::getline(stream, line);) {
        if (!line.empty() && line.back() == '\r')
            line.pop_back();
        if (line.empty())
            continue;
        const std::size_t at = line.find('=');
        if (at == std::string::npos || at == 0)
            throw tactiled::Error("fields: NAME=VALUE is wanted in each line, not " + line);
        fields.emplace_back(line.substr(0, at), line.substr(at + 1));
    }
    return fields;
}

template <class Packer> void pack_value(Packer& packer, const std::string& value)
{
    double number = 0.0;
    const char* end = value.data() + value.size();
    const auto [stop, fault] = std::from_chars(value.data(), end, number);
    if (fault == std::errc() && stop == end && std::isfinite(number))
        packer.pack(number);
    else if (value == "true" || value == "false")
        packer.pack(value == "true");
    else if (value.size() >= 2 && value.front() == '"' && value.back() == '"')
        packer.pack(value.substr(1, value.size() - 2));
    else
        packer.pack(value);
}

double number_of(const msgpack::object& object)
{
    return object.type == msgpack::type::BOOLEAN ? double(object.as<bool>()) : object.as<double>();
}

}  // namespace

struct tactiled_client {
    tactiled_client(const char* endpoint, const char* topics, const tactiled::Options& options)
        : endpoint(endpoint), options(options), subscription(endpoint, words_of(topics), options)
    {
    }

    bool is(tactiled::Kind kind) const { return item && item->kind == kind; }

    // The newest item where it is a message, else nullptr.
    const tactiled::Message* message() const
    {
        const bool is_one = is(tactiled::Kind::MESSAGE) || is(tactiled::Kind::RECOVERED);
        return is_one ? &item->message : nullptr;
    }

    const msgpack::object& field(const char* name)
    {
        if (!message())
            throw tactiled::Error("the newest item is no message");
        if (!is_unpacked) {
            zone.clear();
            map = tactiled::detail::unpack(zone, message()->payload);
            is_unpacked = true;
        }
        const msgpack::object* found = tactiled::detail::find(map, name);
        if (!found)
            throw tactiled::Error(message()->topic + " has no field " + name);
        return *found;
    }

    // Read a field by `read`; `failed` where it is missing or of another type.
    template <class Result, class Read> Result read(Result failed, const char* name, const Read& read)
    {
        return guarded(failed, [&] {
            const msgpack::object& found = field(name);
            try {
                return read(found);
            } catch (const msgpack::type_error&) {
                throw tactiled::Error(message()->topic + ": field " + name + " is of another type");
            }
        });
    }

    std::string endpoint;
    tactiled::Options options;
    tactiled::Subscription subscription;
    std::unique_ptr<tactiled::Commander> commander;  // from the first command on
    const tactiled::Item* item = nullptr;  // newest, of `subscription`
    bool is_unpacked = false;              // `map` has its message
    msgpack::zone zone;
    msgpack::object map;
    std::string text;
};

const char* tactiled_error(void) { return error.c_str(); }

tactiled_client* tactiled_open(const char* endpoint, const char* topics, const char* board, const char* keys)
{
    return guarded(static_cast<tactiled_client*>(nullptr), [&] {
        if (!endpoint)
            throw tactiled::Error("endpoint: none is given; it should look like tcp://127.0.0.1:9872");
        tactiled::Options options;
        options.board = text_or_empty(board);
        options.keys = text_or_empty(keys);
        return new tactiled_client(endpoint, topics, options);
    });
}

void tactiled_close(tactiled_client* client) { delete client; }

int tactiled_next(tactiled_client* client, double wait_s)
{
    return guarded(int(TACTILED_FAILED), [&] {
        client->is_unpacked = false;
        client->item = nullptr;
        if (wait_s == 0.0)
            client->item = client->subscription.poll();
        else
            client->item =
                client->subscription.next(wait_s < 0.0 ? tactiled::INF : tactiled::monotonic_s() + wait_s);
        return client->item ? TACTILED_MESSAGE + static_cast<int>(client->item->kind) : int(TACTILED_NONE);
    });
}

int tactiled_fd(tactiled_client* client)
{
    return guarded(-1, [&] { return client->subscription.fd(); });
}

int tactiled_is_fresh(const tactiled_client* client) { return client->subscription.fresh(); }

const char* tactiled_topic(const tactiled_client* client)
{
    if (client->message())
        return client->message()->topic.c_str();
    return client->is(tactiled::Kind::LOST) ? client->item->topic.c_str() : "";
}

const char* tactiled_board(const tactiled_client* client)
{
    if (client->message())
        return client->message()->board.c_str();
    const bool has_one = client->is(tactiled::Kind::LOST) || client->is(tactiled::Kind::RESTARTED);
    return has_one ? client->item->board.c_str() : "";
}

const char* tactiled_reason(const tactiled_client* client)
{
    const bool has_one = client->is(tactiled::Kind::STALE) || client->is(tactiled::Kind::MALFORMED);
    return has_one ? client->item->reason.c_str() : "";
}

std::uint64_t tactiled_count(const tactiled_client* client)
{
    return client->is(tactiled::Kind::LOST) ? client->item->count : 0;
}

double tactiled_age_s(const tactiled_client* client)
{
    const tactiled::Message* message = client->message();
    return message ? message->age_s(tactiled::monotonic_s()) : std::numeric_limits<double>::quiet_NaN();
}

int tactiled_number(tactiled_client* client, const char* field, double* value)
{
    return client->read(-1, field, [&](const msgpack::object& found) {
        *value = number_of(found);
        return 0;
    });
}

long tactiled_numbers(tactiled_client* client, const char* field, double* values, std::size_t most)
{
    return client->read(-1L, field, [&](const msgpack::object& found) {
        if (found.type != msgpack::type::ARRAY)
            throw msgpack::type_error();
        for (std::size_t n = 0; n < found.via.array.size && n < most; ++n)
            values[n] = number_of(found.via.array.ptr[n]);
        return static_cast<long>(found.via.array.size);
    });
}

const char* tactiled_text(tactiled_client* client, const char* field)
{
    return client->read(static_cast<const char*>(nullptr), field, [&](const msgpack::object& found) {
        client->text = found.as<std::string>();
        return client->text.c_str();
    });
}

const unsigned char* tactiled_payload(const tactiled_client* client, std::size_t* size)
{
    const tactiled::Message* message = client->message();
    *size = message ? message->payload.size() : 0;
    return message ? reinterpret_cast<const unsigned char*>(message->payload.data()) : nullptr;
}

int tactiled_command(tactiled_client* client, const char* command, const char* fields)
{
    return guarded(-1, [&] {
        Fields values = fields_of(fields);
        if (const std::string& board = client->options.board; !board.empty())
            values.emplace_back("board", '"' + board + '"');  // text, also where it looks like a number
        if (!client->commander)
            client->commander = std::make_unique<tactiled::Commander>(client->endpoint, client->options);
        const tactiled::Reply reply = client->commander->send_fields(
            text_or_empty(command), static_cast<std::uint32_t>(values.size()), [&values](auto& packer) {
                for (const auto& [name, value] : values) {
                    packer.pack(name);
                    pack_value(packer, value);
                }
            });
        error = reply.reason;
        return reply.ok ? 0 : 1;
    });
}
