// Client of tactiled: events as they happen, with their age and with notice of losses, and commands.
//
//     tactiled::Subscription events(tactiled::DEFAULT_ENDPOINT, {"slip"});
//     tactiled::Slip slip;
//     for (;;) {
//         const tactiled::Item* item = events.next(tactiled::monotonic_s() + 0.1);
//         if (item && item->kind == tactiled::Kind::STALE) hold_without_touch(item->reason);
//         if (item && item->kind == tactiled::Kind::MESSAGE && item->message.read(slip) && events.fresh() &&
//             slip.valid && std::abs(item->message.age_s(tactiled::monotonic_s())) < 0.2) tighten();
//     }
//
// The rules are those of tactiled.client in Python; docs/native.md says how to use and build it. What becomes of
// received messages is in tactiled_inbox.hpp. Use each object from one thread at a time. ZeroMQ starts a thread
// for each object.
//
// Needs C++17 and Linux, libzmq and cppzmq (4.9).
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <initializer_list>
#include <iterator>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tactiled_sockets.hpp"

namespace tactiled {

namespace detail {

// The same topics; throws Error where one is unknown.
inline std::vector<std::string> known(std::vector<std::string> topics)
{
    for (const std::string& topic : topics) {
        if (std::find(std::begin(TOPICS), std::end(TOPICS), topic) != std::end(TOPICS))
            continue;
        std::string words = "topics: no topic '" + topic + "'; there are:";
        for (const char* name : TOPICS)
            words += std::string(name == TOPICS[0] ? " " : ", ") + name;
        throw Error(words);
    }
    return topics;
}

}  // namespace detail

// Receives items from a daemon: messages, and notice of losses, of a restart and of old data. It connects, and
// connects again, by itself.
class Subscription {
public:
    // `topics`: those of TOPICS that are wanted; empty for all. Throws Error for an unknown topic, and for a
    // wrong endpoint or file of keys; a daemon that is not there shows as Kind::STALE.
    explicit Subscription(const std::string& endpoint = DEFAULT_ENDPOINT,
                          std::vector<std::string> topics = {}, const Options& options = {})
        : Subscription(endpoint, Wanted{detail::known(std::move(topics)), options.board},
                       options.control.value_or(control_endpoint(endpoint)), options)
    {
    }

    // Wait for the next item. Returns nullptr if none came before `monotonic_s()` reached `until_s`, or if a
    // signal interrupted the call; by default, the call waits for ever. The item is valid until the next call
    // of `next` or `poll`.
    const Item* next(double until_s = INF)
    {
        for (;;) {
            if (const Item* item = read())
                return item;
            if (monotonic_s() >= until_s || !wait(std::min(until_s, deadline_s())))
                return nullptr;
        }
    }

    // Next item without waiting, or nullptr for none. The item is valid until the next call of `next` or `poll`.
    const Item* poll()
    {
        may_receive_ = may_have_reply_ = true;
        const Item* item = read();
        if (!item && descriptor_)
            descriptor_->set_deadline(deadline_s());
        return item;
    }

    // Descriptor for poll, epoll or an event loop. When it is readable, call `poll` until it returns nullptr:
    // only then does it become readable again.
    int fd()
    {
        if (!descriptor_)
            descriptor_.emplace(std::initializer_list<int>{events_fd_, requests_fd_});
        descriptor_->set_deadline(deadline_s());
        return descriptor_->fd();
    }

    // True while tactile data may be acted on: between FRESH and STALE, and with a recent status.
    bool fresh() const { return inbox_.is_fresh(monotonic_s()); }

    // Numbers of items since the beginning.
    std::uint64_t lost() const { return inbox_.lost(); }            // messages that cannot be recovered
    std::uint64_t recovered() const { return inbox_.recovered(); }  // messages that were missed and recovered
    std::uint64_t malformed() const { return inbox_.malformed(); }  // received data that are no message

private:
    Subscription(const std::string& endpoint, const Wanted& wanted, const std::string& control,
                 const Options& options)
        : events_(detail::connect_events(context_, endpoint, wanted, options.keys)),
          inbox_(wanted, options.stale_after_s, monotonic_s(), !control.empty(), detail::random_hex(8))
    {
        if (!control.empty())
            requests_ = detail::connect_requests(context_, control, options.keys);
        events_fd_ = detail::fd_of(events_);
        requests_fd_ = detail::fd_of(requests_);
    }

    // Next item; nullptr once nothing can be read.
    const Item* read()
    {
        for (;;) {
            if (const Item* item = items_.take())
                return item;
            if (may_have_reply_)
                take_replies();
            may_receive_ = may_receive_ && receive();
            if (items_.empty())  // a message that has come is not delayed further
                inbox_.tick(monotonic_s(), items_);
            // While ZeroMQ sends, or tries to, it takes note of replies that have come, and signals them no
            // more.
            may_have_reply_ = !inbox_.requests().unsent().empty();
            const bool has_sent = send_requests();
            if (items_.empty() && !may_receive_ && !has_sent)
                return nullptr;
        }
    }

    void take_replies()
    {
        while (requests_.handle() && detail::take(requests_, parts_[0])) {
            while (parts_[0].more() && detail::take(requests_, parts_[0])) {}
            inbox_.answer(detail::view(parts_[0]), monotonic_s(), unix_s(), items_);
        }
    }

    // Wait for something to read, until an instant at most; false where a signal interrupted.
    bool wait(double until_s)
    {
        const double wait_s = until_s - monotonic_s();
        // Without a request, the socket waits: a system call less between a message and its reader.
        if (wait_s >= 1e-3 && !inbox_.requests().is_waiting()) {
            const int wait_ms = static_cast<int>(1e3 * std::min(wait_s, detail::LONGEST_WAIT_S));
            if (wait_ms < timeout_ms_ || wait_ms / 2 > timeout_ms_) {  // a wait that ends early is begun again
                events_.set(zmq::sockopt::rcvtimeo, wait_ms);
                timeout_ms_ = wait_ms;
            }
            has_part_ = may_receive_ = zmq_msg_recv(parts_[0].handle(), events_.handle(), 0) >= 0;
            return has_part_ || zmq_errno() == EAGAIN;
        }
        pollfd waits[] = {{events_fd_, POLLIN, 0}, {requests_fd_, POLLIN, 0}};
        if (!detail::wait(waits, until_s))
            return false;
        may_receive_ = waits[0].revents != 0;
        may_have_reply_ = may_have_reply_ || waits[1].revents != 0;
        return true;
    }

    // Read at most one message.
    bool receive()
    {
        if (!std::exchange(has_part_, false) && !detail::take(events_, parts_[0]))
            return false;
        std::size_t count = 1;
        for (bool more = parts_[0].more(); more; ++count)
            more = detail::take(events_, parts_[count == 1 ? 1 : 2]) && parts_[count == 1 ? 1 : 2].more();
        const Frames frames{count, detail::view(parts_[0]),
                            count > 1 ? detail::view(parts_[1]) : std::string_view()};
        inbox_.receive(frames, monotonic_s(), unix_s(), items_);
        return true;
    }

    // Send pending requests while the daemon is connected; true where one was sent.
    bool send_requests()
    {
        bool has_sent = false;
        while (!inbox_.requests().unsent().empty()) {
            std::string payload;
            inbox_.requests().unsent().front().pack(payload);
            if (!requests_.handle() || !detail::send(requests_, payload))
                break;
            inbox_.requests().sent();
            has_sent = true;
        }
        return has_sent;
    }

    // Instant at which something is due although nothing arrives.
    double deadline_s()
    {
        const double due_s = inbox_.deadline_s();
        return inbox_.requests().unsent().empty() ? due_s : std::min(due_s, monotonic_s() + detail::RETRY_S);
    }

    zmq::context_t context_;
    zmq::socket_t events_, requests_;  // requests_ has no handle where nothing is requested
    int events_fd_ = -1, requests_fd_ = -1;
    int timeout_ms_ = -1;  // of a wait of events_; ZeroMQ's own is none
    // A descriptor is signalled once; from then on, a socket is read until it has nothing more.
    bool may_receive_ = true, may_have_reply_ = true;
    bool has_part_ = false;    // the first part was taken
    zmq::message_t parts_[3];  // topic, payload, and what should not be there
    Inbox inbox_;
    Items items_;
    std::optional<detail::Descriptor> descriptor_;
};

// Reply of the daemon to a command.
struct Reply {
    bool ok = false;
    std::string reason;   // for a refusal; empty where `ok`
    std::string payload;  // msgpack map (protocols/control.md)
};

// Sends commands to a daemon, one at a time.
//
//     tactiled::Commander daemon("ipc:///run/tactiled/all/events.ipc");
//     daemon.send("inhibit", "duration_s", 0.4);  // our own motion must not count as slip
//
// A command is sent once, as soon as the daemon is connected. Without a reply in time it may have been carried
// out, or not; the caller decides whether to send it again. A command beyond 16,128 bytes throws Error.
class Commander {
public:
    // Longest wait for a reply. A reply takes a millisecond; a daemon that is being restarted is back within
    // this time.
    static constexpr double TIMEOUT_S = 5.0;

    // `endpoint` is that of events, as for Subscription; `control_endpoint` tells that of commands. Give an ipc
    // endpoint: over TCP, as by default, the daemon refuses commands without keys, unless its configuration
    // allows them. Throws Error for a wrong endpoint or file of keys.
    explicit Commander(const std::string& endpoint = DEFAULT_ENDPOINT, const Options& options = {})
        : endpoint_(options.control.value_or(control_endpoint(endpoint))),
          who_(options.who),
          socket_(detail::connect_requests(context_, endpoint_, options.keys)),
          name_(detail::random_hex(8))
    {
    }

    // Send a command (protocols/control.md) and wait for the reply. Fields are names and values in turn; values
    // are numbers, texts, vectors or maps of texts. Throws Error where no reply came within TIMEOUT_S; the
    // command may have been carried out all the same.
    template <class... Fields> Reply send(const std::string& command, const Fields&... fields)
    {
        begin(command, fields...);
        return wait();
    }

    // The same where the number of fields is not known to the compiler. `pack_fields` is called with a packer,
    // and packs each name and value: [](auto& packer) { packer.pack("duration_s").pack(0.4); }
    template <class PackFields>
    Reply send_fields(const std::string& command, std::uint32_t n_fields, const PackFields& pack_fields)
    {
        begin_fields(command, n_fields, pack_fields);
        return wait();
    }

    // Send a command without waiting; `poll` returns its reply. The replies to earlier commands are dropped.
    // Until the daemon is connected, the newest 64 commands wait; of `motion`, the newest alone.
    template <class... Fields> void begin(const std::string& command, const Fields&... fields)
    {
        static_assert(sizeof...(Fields) % 2 == 0, "fields are pairs of name and value");
        begin_fields(command, sizeof...(Fields) / 2, [&]([[maybe_unused]] auto& packer) {
            (packer.pack(fields), ...);
        });
    }

    // Reply to the newest command, once; nullptr while there is none. Call it from time to time, because it
    // sends commands that wait for the connection. Throws Error where no command got a reply within TIMEOUT_S;
    // commands that wait are dropped then. The reply is valid until the next command or call of `poll`.
    const Reply* poll()
    {
        if (id_.empty())
            return nullptr;
        const bool has_come = poll_socket();
        if (has_come)
            id_.clear();
        else if (monotonic_s() >= until_s_) {
            id_.clear();
            unsent_.clear();
            throw Error(endpoint_ + ": " + detail::no_answer(endpoint_));
        }
        if (descriptor_)
            descriptor_->set_deadline(deadline_s());
        return has_come ? &reply_ : nullptr;
    }

    // Descriptor for poll, epoll or an event loop. When it is readable, call `poll`.
    int fd()
    {
        if (!descriptor_)
            descriptor_.emplace(std::initializer_list<int>{detail::fd_of(socket_)});
        descriptor_->set_deadline(deadline_s());
        return descriptor_->fd();
    }

private:
    // A request has at most 16,384 bytes (protocols/control.md); a bridge to zenoh adds some to them.
    static constexpr std::size_t MOST_BYTES = 16128;
    static constexpr std::size_t MOST_UNSENT = 64;  // bounds the memory; as many as ZeroMQ queues

    struct Unsent {
        std::string command, request;
    };

    template <class PackFields>
    void begin_fields(const std::string& command, std::uint32_t n_fields, const PackFields& pack_fields)
    {
        const std::string id = name_ + "-" + std::to_string(++number_);
        std::string request;
        detail::Packer packer(request);
        packer.pack_map(4 + n_fields);
        packer.pack("v").pack(1).pack("id").pack(id).pack("do").pack(command);
        packer.pack("who").pack(who_);
        pack_fields(packer);
        if (request.size() > MOST_BYTES)
            throw Error(command + ": " + std::to_string(request.size()) + " bytes, a request has at most " +
                        std::to_string(MOST_BYTES));
        if (id_.empty())  // a daemon that replies to none of many commands is dead
            until_s_ = monotonic_s() + TIMEOUT_S;
        id_ = id;
        if (command == "motion")  // the acceleration of the past is none of now
            unsent_.erase(std::remove_if(unsent_.begin(), unsent_.end(),
                                         [](const Unsent& waiting) { return waiting.command == "motion"; }),
                          unsent_.end());
        if (unsent_.size() == MOST_UNSENT)
            unsent_.pop_front();
        unsent_.push_back(Unsent{command, std::move(request)});
        send_unsent();
    }

    void send_unsent()
    {
        while (!unsent_.empty() && detail::send(socket_, unsent_.front().request))
            unsent_.pop_front();
    }

    Reply wait()
    {
        until_s_ = monotonic_s() + TIMEOUT_S;
        for (;;) {
            if (const Reply* reply = poll())
                return *reply;
            pollfd waits[] = {{detail::fd_of(socket_), POLLIN, 0}};
            detail::wait(waits, deadline_s());
        }
    }

    double deadline_s() const
    {
        if (id_.empty())
            return INF;
        return unsent_.empty() ? until_s_ : std::min(until_s_, monotonic_s() + detail::RETRY_S);
    }

    // Send what waits, and take replies until one is that of the newest command.
    bool poll_socket()
    {
        send_unsent();
        while (detail::take(socket_, part_)) {
            while (part_.more() && detail::take(socket_, part_)) {}
            if (is_reply())
                return true;
        }
        return false;
    }

    bool is_reply()
    {
        std::string fault;
        detail::Head head;
        if (!detail::check_map(detail::view(part_), "reply", head, fault))
            return false;
        detail::read_entries(detail::view(part_), entries_);
        const std::string id(detail::text_of(detail::find(entries_, "id")));
        if (id.rfind(name_ + "-", 0) == 0)  // the daemon lives
            until_s_ = monotonic_s() + TIMEOUT_S;
        if (id != id_)
            return false;
        reply_.ok = detail::is_true(detail::find(entries_, "ok"));
        reply_.reason = detail::text_of(detail::find(entries_, "reason"));
        reply_.payload = detail::view(part_);
        return true;
    }

    std::string endpoint_, who_;
    zmq::context_t context_;
    zmq::socket_t socket_;
    zmq::message_t part_;
    std::string name_, id_;  // id of the command that waits for its reply; empty for none
    std::uint64_t number_ = 0;
    double until_s_ = 0.0;
    std::deque<Unsent> unsent_;  // until the daemon is connected
    std::vector<detail::Entry> entries_;  // of the reply that is read now
    Reply reply_;
    std::optional<detail::Descriptor> descriptor_;
};

}  // namespace tactiled
