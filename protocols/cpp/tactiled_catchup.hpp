// Order of the messages of each topic, and recovery of missed ones from the daemon.
//
// The rules are those of tactiled.client.catchup, for a connection over ZeroMQ. A hole shows in the sequence
// numbers of a topic, or in a status, which has the number of messages sent on every topic. The daemon is
// asked for missing messages, and newer ones of that topic wait for its answer: a millisecond on one host, at
// most HOLD_S. What has waited for longer than WAITS_S is handed on as recovered. What the daemon no longer has, or does not return in time, is lost. After that, and before the
// first answer of the daemon, nothing waits. Sequence numbers begin at 0 with each run of the daemon.
//
// Pure: no input, no output, no clock.
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tactiled_items.hpp"

namespace tactiled {

constexpr double INF = std::numeric_limits<double>::infinity();

// Question to the daemon: its state, or the messages of a topic from one number to before another.
struct Request {
    std::string id;
    std::string ask;  // "state" or "events"
    std::string board, topic;
    std::uint64_t first_seq = 0, end_seq = 0;

    void pack(std::string& out) const
    {
        detail::Packer packer(out);
        packer.pack_map(ask == "events" ? 7 : 3);
        packer.pack("v").pack(detail::MESSAGE_VERSION).pack("id").pack(id).pack("do").pack(ask);
        if (ask == "events") {
            packer.pack("board").pack(board).pack("topic").pack(topic);
            packer.pack("first_seq").pack(first_seq).pack("end_seq").pack(end_seq);
        }
    }
};

// Puts messages in order and fills holes.
class CatchUp {
public:
    // More than a reconnection to the daemon takes (0.1 s), and little enough for a controller.
    static constexpr double HOLD_S = 0.5;
    static constexpr double WAITS_S = 0.2;  // the longest that a message waits and still counts as present
    static constexpr double PROBE_S = 1.0;  // period of asking a daemon that does not answer
    static constexpr std::size_t MOST_HELD =
        4000;  // of a topic: 40 s of scans, far more than come within HOLD_S
    static constexpr std::size_t MOST_TOPICS = 1024;  // bounds what a publisher of invalid topics can occupy

    // `name` begins the ids of requests: a relay of several clients tells them apart by it.
    CatchUp(bool enabled, double now_s, const Wanted& wanted, std::string name)
        : wanted_(wanted), name_(std::move(name)), probe_s_(enabled ? now_s : INF)
    {
    }

    std::uint64_t lost() const { return lost_; }
    std::uint64_t recovered() const { return recovered_; }

    // Requests to send; call `sent` for the first when it left.
    const std::vector<Request>& unsent() const { return unsent_; }
    void sent() { unsent_.erase(unsent_.begin()); }

    // True while a reply is needed.
    bool is_waiting() const { return deadline_s() < INF || !unsent_.empty(); }

    // Time of the next `tick`, monotonic seconds.
    double deadline_s() const
    {
        double due_s = probe_s_;
        for (const Line& line : lines_)
            due_s = std::min(due_s, line.until_s);
        return due_s;
    }

    // Time at which the oldest message that waits behind a hole was read; INF for none.
    double waits_from_s() const
    {
        double from_s = INF;
        for (const Line& line : lines_)
            if (!line.held.empty())
                from_s = std::min(from_s, line.held.front().received_s);
        return from_s;
    }

    void tick(double now_s, Items& out)
    {
        if (now_s >= probe_s_) {
            probe_s_ = now_s + PROBE_S;
            drop_unsent([](const Request& request) { return request.ask == "state"; });
            ask("state");
        }
        for (Line& line : lines_) {
            if (now_s < line.until_s)
                continue;
            give_up(line, now_s, out);
            answered_ = false;
            probe_s_ = now_s + PROBE_S;
        }
    }

    // True for a message of a known board and topic, or while there is room for new ones.
    bool has_room(const Message& message)
    {
        return (find_line(message.board, message.topic) || lines_.size() < MOST_TOPICS) &&
               (find_board(message.board) || boards_.size() < MOST_TOPICS);
    }

    // True for a message that the daemon sent before its restart, and that was overtaken.
    bool is_of_old_run(const Message& message)
    {
        const Board* board = find_board(message.board);
        return board && board->old_run == message.run;
    }

    // Detect a message of a new run of the daemon, and give up the holes of the old one.
    void watch_run(const Message& message, Items& out)
    {
        Board& board = board_of(message);
        if (board.run == message.run)
            return;
        board.old_run = board.run;
        board.run = message.run;
        board.is_new_run = true;
        for (Line& line : lines_) {
            if (line.board != message.board)
                continue;
            give_up(line, message.received_s, out);
            line = Line{line.board, line.topic};
        }
        out.add(Kind::RESTARTED).board = message.board;
    }

    // Take a received message, which is moved from; add the messages that are in order now.
    void place(Message& message, double now_s, Items& out)
    {
        const auto retained = find_retained(message.board, message.topic);
        if (retained != retained_.end() && retained->seq < message.seq)
            give_retained(retained, out);
        Line* line = line_of(message.board, message.topic, message.seq);
        if (!line || message.seq < line->next_seq)  // recovered already
            return;
        line->end_seq = std::max(line->end_seq, message.seq + 1);
        if (line->held.empty() && !line->hole_end && message.seq == line->next_seq)
            give(*line, message, now_s, out);
        else
            line->held.push_back(std::move(message));
        if (line->hole_end && line->held.size() <= MOST_HELD)
            return;
        settle(*line, line->hole_end, now_s, out);
    }

    // Take note that all messages before `end_seq` were sent, which a status shows.
    void expect(std::string_view board, std::string_view topic, std::uint64_t end_seq, double now_s,
                Items& out)
    {
        Line* line = line_of(board, topic, end_seq);
        if (!line)
            return;
        line->end_seq = std::max(line->end_seq, end_seq);
        if (!line->hole_end)
            settle(*line, 0, now_s, out);
    }

    // Take note of a status, after `expect`; add retained messages of topics without a newer one. A reply
    // overtakes messages that wait to be read: retained messages that were handed on at once would hide older
    // ones.
    void status_read(const std::string& name, Items& out)
    {
        if (Board* board = find_board(name))
            board->has_status = true;
        for (std::size_t n = 0; n < retained_.size();) {
            if (retained_[n].board == name)
                give_retained(retained_.begin() + static_cast<std::ptrdiff_t>(n), out);
            else
                ++n;
        }
    }

    // Take a reply, a checked map, whatever it contains.
    void answer(std::string_view reply, double now_s, double unix_s, Items& out)
    {
        detail::read_entries(reply, entries_);
        const auto field = [this](std::string_view key) { return detail::find(entries_, key); };
        const std::string_view messages = field("messages");
        if (detail::text_of(field("do")) == "state" && detail::Values(messages).is_map()) {
            const bool is_first = !answered_;
            answered_ = true;
            probe_s_ = INF;
            if (is_first)
                retain(messages, now_s, unix_s, out);
            return;
        }
        Line* line = asked_line(detail::text_of(field("id")));
        if (!line)
            return;  // given up meanwhile
        const Board* board = find_board(line->board);
        std::uint64_t run = 0, settled = line->hole_end;
        const bool is_same_run =
            detail::read_count(field("run"), run) && board && static_cast<std::int64_t>(run) == board->run;
        if (!detail::is_true(field("ok")) || !is_same_run || !detail::Values(messages).is_array()) {
            settle(*line, line->hole_end, now_s, out);
            return;
        }
        const std::uint64_t before = line->next_seq;
        fill(*line, messages, now_s, unix_s, out);
        detail::read_field(
            field("next_seq"), [settled](detail::Values& values) { return values.take_clamped(settled); },
            settled);
        const bool has_gone_on = before < line->next_seq && line->next_seq < line->hole_end;
        if (detail::is_true(field("more")) && has_gone_on)
            ask_for(*line, line->hole_end, now_s);
        else
            settle(*line, std::max(settled, line->next_seq), now_s, out);
    }

private:
    // State of one topic of one board.
    struct Line {
        std::string board, topic;
        std::uint64_t next_seq = 0;
        std::uint64_t end_seq = 0;   // end of the sequence numbers that are known to have been sent
        std::uint64_t hole_end = 0;  // end of the hole that was requested; 0 for none
        std::string asked = {};      // id of that request
        double until_s = INF;
        std::deque<Message> held = {};
        bool given = false;  // true after any message of the topic was handed on
    };

    struct Board {
        std::string name;
        std::int64_t run;
        bool is_new_run = false;  // its present run was observed from its beginning
        bool has_status = false;  // a status was read
        std::optional<std::int64_t> old_run = {};  // of which late messages may come
    };

    using Retained = std::vector<Message>::iterator;

    Line* find_line(std::string_view board, std::string_view topic)
    {
        for (Line& line : lines_)
            if (line.topic == topic && line.board == board)
                return &line;
        return nullptr;
    }

    Line* asked_line(std::string_view id)
    {
        for (Line& line : lines_)
            if (!id.empty() && line.asked == id)
                return &line;
        return nullptr;
    }

    // State of a topic; a new one begins at `joined_seq`, because earlier messages are not lost.
    Line* line_of(std::string_view board, std::string_view topic, std::uint64_t joined_seq)
    {
        Line* line = find_line(board, topic);
        if (line || lines_.size() >= MOST_TOPICS)
            return line;
        const Board* known = find_board(board);
        lines_.push_back(
            Line{std::string(board), std::string(topic), known && known->is_new_run ? 0 : joined_seq});
        return &lines_.back();
    }

    Board* find_board(std::string_view name)
    {
        for (Board& board : boards_)
            if (board.name == name)
                return &board;
        return nullptr;
    }

    // Board of a message; a new one has its run.
    Board& board_of(const Message& message)
    {
        if (Board* board = find_board(message.board))
            return *board;
        boards_.push_back(Board{message.board, message.run});
        return boards_.back();
    }

    Retained find_retained(std::string_view board, std::string_view topic)
    {
        return std::find_if(retained_.begin(), retained_.end(), [&](const Message& message) {
            return message.topic == topic && message.board == board;
        });
    }

    // Kind of a message, which may have waited for too long to count as present.
    static Kind kind_of(const Message& message, double now_s)
    {
        return now_s - message.received_s <= WAITS_S ? Kind::MESSAGE : Kind::RECOVERED;
    }

    static void give(Line& line, Message& message, double now_s, Items& out)
    {
        line.next_seq = message.seq + 1;
        line.given = true;
        std::swap(out.add(kind_of(message, now_s)).message, message);
    }

    // Hand on messages of a reply that belong to the hole.
    void fill(Line& line, std::string_view messages, double now_s, double unix_s, Items& out)
    {
        detail::Values values(messages);
        for (std::uint64_t n_left = values.take_array(); n_left > 0; --n_left) {
            Message message;
            if (!read(line.topic, values.skip(), now_s, unix_s, message) ||
                message.seq < line.next_seq || message.seq >= line.hole_end)
                continue;
            lose(line, message.seq, out);
            line.next_seq = message.seq + 1;
            ++recovered_;
            recover(message, out);
        }
    }

    // Count missing messages before `settled_seq` as lost; go on to the next hole, and request it.
    void settle(Line& line, std::uint64_t settled_seq, double now_s, Items& out)
    {
        lose(line, settled_seq, out);
        forget(line);
        for (;;) {
            while (!line.held.empty() && line.held.front().seq <= line.next_seq) {
                if (line.held.front().seq == line.next_seq)
                    give(line, line.held.front(), now_s, out);
                line.held.pop_front();
            }
            const std::uint64_t hole_end = line.held.empty() ? line.end_seq : line.held.front().seq;
            if (hole_end <= line.next_seq)
                return;
            if (answered_ && line.held.size() <= MOST_HELD) {
                ask_for(line, hole_end, now_s);
                return;
            }
            lose(line, hole_end, out);
        }
    }

    // Count the holes of a topic as lost, and hand on the messages that wait behind them.
    void give_up(Line& line, double now_s, Items& out)
    {
        forget(line);
        for (Message& message : line.held) {
            if (message.seq < line.next_seq)
                continue;
            lose(line, message.seq, out);
            line.next_seq = message.seq + 1;
            std::swap(out.add(kind_of(message, now_s)).message, message);
        }
        line.held.clear();
        lose(line, line.end_seq, out);
    }

    void lose(Line& line, std::uint64_t before_seq, Items& out)
    {
        if (before_seq <= line.next_seq)
            return;
        Item& item = out.add(Kind::LOST);
        item.topic = line.topic;
        item.board = line.board;
        item.count = before_seq - line.next_seq;
        lost_ += item.count;
        line.next_seq = before_seq;
    }

    // Take the newest message of each topic, and hand on those whose order is known.
    void retain(std::string_view messages, double now_s, double unix_s, Items& out)
    {
        detail::read_entries(messages, entries_);
        detail::keep_last(entries_);
        for (const detail::Entry& entry : entries_) {
            const std::string_view topic = entry.key.substr(entry.key.rfind('/') + 1);  // npos + 1 is 0: all of it
            Message message;
            const bool is_read = read(topic, entry.value, now_s, unix_s, message);
            if (topic == "scan" || topic == "status" || !is_read || !has_room(message))
                continue;
            const Board* board = find_board(message.board);
            const bool is_known = (board && board->has_status) || find_line(message.board, topic);
            auto retained = find_retained(message.board, topic);
            if (retained == retained_.end())
                retained = retained_.insert(retained, std::move(message));
            else
                *retained = std::move(message);
            if (is_known)
                give_retained(retained, out);
        }
    }

    // Hand on the newest message of a topic to a new subscriber.
    void give_retained(Retained retained, Items& out)
    {
        Message message = std::move(*retained);
        retained_.erase(retained);
        if (board_of(message).run != message.run)
            return;
        Line* line = line_of(message.board, message.topic, message.seq + 1);
        if (!line || line->given || line->next_seq != message.seq + 1)
            return;
        line->given = true;
        recover(message, out);
    }

    void recover(Message& message, Items& out)
    {
        if (wanted_.has_topic(message.topic) && wanted_.has_board(message.board))
            std::swap(out.add(Kind::RECOVERED).message, message);
    }

    // Read a message of a reply; false where it is none.
    static bool read(std::string_view topic, std::string_view packed, double now_s, double unix_s,
                     Message& out)
    {
        std::string reason;
        detail::Head head;
        if (!detail::Values(packed).is_map() || !detail::check(packed, evidence_key(topic), head) ||
            !detail::read_head(topic, head, now_s, unix_s, out, reason))
            return false;
        out.payload = packed;
        return true;
    }

    void ask_for(Line& line, std::uint64_t end_seq, double now_s)
    {
        line.hole_end = end_seq;
        line.until_s = now_s + HOLD_S;
        Request& request = ask("events");
        request.board = line.board;
        request.topic = line.topic;
        request.first_seq = line.next_seq;
        request.end_seq = end_seq;
        line.asked = request.id;
    }

    Request& ask(const std::string& what)
    {
        unsent_.push_back(Request{what + "-" + name_ + "-" + std::to_string(++number_), what, {}, {}});
        return unsent_.back();
    }

    // Forget the request for a hole.
    void forget(Line& line)
    {
        if (!line.asked.empty())
            drop_unsent([&line](const Request& request) { return request.id == line.asked; });
        line.asked.clear();
        line.hole_end = 0;
        line.until_s = INF;
    }

    template <class Predicate> void drop_unsent(Predicate predicate)
    {
        unsent_.erase(std::remove_if(unsent_.begin(), unsent_.end(), predicate), unsent_.end());
    }

    Wanted wanted_;
    std::string name_;
    std::uint64_t number_ = 0, lost_ = 0, recovered_ = 0;
    std::deque<Line> lines_;  // references to its elements stay valid when it grows
    std::deque<Board> boards_;
    std::vector<Request> unsent_;
    std::vector<Message> retained_;  // handed on after the next message or status
    std::vector<detail::Entry> entries_;  // of the reply that is read now
    bool answered_ = false;
    double probe_s_;
};

}  // namespace tactiled
