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
#include <string_view>
#include <utility>
#include <vector>

#include "tactiled.hpp"

using tactiled::detail::Values;

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

void pack_value(tactiled::detail::Packer& packer, const std::string& value)
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

double take_number(Values& values) { return values.is_bool() ? values.take_bool() : values.take_number(); }

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

    Values field(const char* name)
    {
        if (!message())
            throw tactiled::Error("the newest item is no message");
        if (!is_read) {
            tactiled::detail::read_entries(message()->payload, entries);
            is_read = true;
        }
        const std::string_view found = tactiled::detail::find(entries, name);
        if (found.empty())
            throw tactiled::Error(message()->topic + " has no field " + name);
        return Values(found);
    }

    // Read a field by `read`; `failed` where it is missing or of another type.
    template <class Result, class Read> Result read(Result failed, const char* name, const Read& read)
    {
        return guarded(failed, [&] {
            Values values = field(name);
            try {
                return read(values);
            } catch (const tactiled::detail::Unreadable&) {
                throw tactiled::Error(message()->topic + ": field " + name + " is of another type");
            }
        });
    }

    std::string endpoint;
    tactiled::Options options;
    tactiled::Subscription subscription;
    std::unique_ptr<tactiled::Commander> commander;  // from the first command on
    const tactiled::Item* item = nullptr;  // newest, of `subscription`
    bool is_read = false;                  // `entries` are those of its message
    std::vector<tactiled::detail::Entry> entries;
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
        client->is_read = false;
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
    return client->read(-1, field, [&](Values& values) {
        *value = take_number(values);
        return 0;
    });
}

long tactiled_numbers(tactiled_client* client, const char* field, double* values, std::size_t most)
{
    return client->read(-1L, field, [&](Values& found) {
        const std::uint64_t size = found.take_array();
        for (std::size_t n = 0; n < size && n < most; ++n)
            values[n] = take_number(found);
        return static_cast<long>(size);
    });
}

const char* tactiled_text(tactiled_client* client, const char* field)
{
    return client->read(static_cast<const char*>(nullptr), field, [&](Values& values) {
        client->text = values.take_text();
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
