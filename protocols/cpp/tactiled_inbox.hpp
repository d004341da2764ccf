// Received frames and passing time in, items out: messages, losses, staleness, malformed data.
//
// The rules are those of tactiled.client.inbox; tests/client/test_client_native.py plays the same streams to
// both. Two conditions make old data look new. Silence: daemon, cable or board is gone, and the last message
// stays the newest. Backlog: this program has paused, and messages wait, each of which was fresh when it was
// sent. A lost message holds back those behind it while it is requested; what waits for over 0.2 s is stale, too.
// Data are therefore fresh only while a status says so that is recent by both clocks; where several
// boards are heard, a status of each.
//
// Pure: no input, no output, no clock. Memory is used again: nothing is allocated for a message in order,
// once the longest of its topic has come.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "tactiled_catchup.hpp"

namespace tactiled {

constexpr double STALE_AFTER_S = 0.5;  // five periods of the status

// Frames of one message of ZeroMQ: how many there are, and the first two.
struct Frames {
    std::size_t count;
    std::string_view topic, payload;
};

// Converts raw frames and passing time to items.
class Inbox {
public:
    static constexpr double CLOCKS_PART = 5e-4;  // largest difference in rate of two hosts' crystals: five
                                                 // times the 100 ppm of a bad one
    static constexpr double ASLEEP_S = 10.0;  // a backlog that the wall clock does not show, because it was set,
                                              // is read within this time
    static constexpr std::size_t MOST_BOARDS = 1024;  // bounds the memory that invalid names can occupy

    // `stale_after_s`: silence, or age of the newest status, that counts as stale. `catch_up`: request missed
    // messages; `requests` has them, `answer` takes the replies.
    Inbox(const Wanted& wanted, double stale_after_s, double now_s, bool catch_up, std::string name)
        : wanted_(wanted),
          catch_up_(catch_up, now_s, wanted, std::move(name)),
          stale_after_s_(stale_after_s),
          status_s_(now_s),
          lead_at_s_(now_s)
    {
    }

    CatchUp& requests() { return catch_up_; }
    std::uint64_t lost() const { return catch_up_.lost(); }
    std::uint64_t recovered() const { return catch_up_.recovered(); }
    std::uint64_t malformed() const { return malformed_; }

    // True while the last status of each board is valid and recent: its data may be acted on.
    bool is_fresh(double now_s) const { return state_ == State::FRESH && now_s < std::min(silence_due_s(), wait_due_s()); }

    // Time of the next `tick`, monotonic seconds.
    double deadline_s() const { return std::min({catch_up_.deadline_s(), silence_due_s(), wait_due_s()}); }

    // Add the items from a received message, whatever it contains.
    void receive(const Frames& frames, double now_s, double unix_s, Items& out)
    {
        tick(now_s, out);  // after a pause, stale comes before the messages that waited
        bool is_malformed = !parse(frames, now_s, unix_s);
        if (!is_malformed && is_message_ && !catch_up_.has_room(message_)) {
            reason_ = message_.topic + ": more boards and topics than any daemon has";
            is_malformed = true;
        }
        if (is_malformed) {
            report_malformed(out);
            return;
        }
        if (!is_message_ || catch_up_.is_of_old_run(message_))
            return;
        catch_up_.watch_run(message_, out);
        if (message_.topic == "status") {
            detail::read_entries(frames.payload, status_);
            watch_age(now_s, unix_s, out);
            expect_sent(now_s, out);
            catch_up_.status_read(message_.board, out);
        }
        if (wanted_.has_topic(message_.topic)) {
            message_.payload = frames.payload;
            catch_up_.place(message_, now_s, out);
        }
    }

    // Add the items from a reply of the daemon, whatever it contains.
    void answer(std::string_view payload, double now_s, double unix_s, Items& out)
    {
        if (detail::check_map(payload, "reply", head_, reason_))
            catch_up_.answer(payload, now_s, unix_s, out);
        else
            report_malformed(out);
    }

    // Add the items that follow from silence and from passed deadlines.
    void tick(double now_s, Items& out)
    {
        if (now_s >= wait_due_s())  // before the messages that waited are handed on
            turn_stale("messages wait for a lost one, which was requested", now_s - catch_up_.waits_from_s(), out);
        catch_up_.tick(now_s, out);
        if (now_s < silence_due_s())
            return;
        const double silent_s = now_s - status_s_;
        turn_stale(
            words("no status read for %.1f s: is tactiled running, or is this client too slow?", silent_s),
            silent_s, out);
    }

private:
    enum class State { UNKNOWN, FRESH, STALE };

    // Time at which silence counts as stale; inf when that was reported already.
    double silence_due_s() const { return state_ == State::STALE ? INF : status_s_ + stale_after_s_; }

    // Time at which messages behind a hole count as stale; inf when that was reported already.
    double wait_due_s() const
    {
        return state_ == State::STALE ? INF : catch_up_.waits_from_s() + CatchUp::WAITS_S;
    }

    // Parse into `message_`, or take note that it was not subscribed; false with a reason where it is
    // malformed.
    bool parse(const Frames& frames, double now_s, double unix_s)
    {
        is_message_ = false;
        if (frames.count != 2) {
            reason_ = std::to_string(frames.count) + " frames, not 2";
            return false;
        }
        if (!detail::is_utf8(frames.topic)) {
            reason_ = "topic is not UTF-8";
            return false;
        }
        const std::string_view path = frames.topic;
        const std::size_t first = path.find('/'), last = path.rfind('/');
        if (path.substr(0, first) != "tactile" || first == last || path.find('/', first + 1) != last) {
            reason_ = "topic '" + std::string(path.substr(0, first)) + "' is not tactile/BOARD/TOPIC";
            return false;
        }
        const std::string_view topic = path.substr(last + 1);
        if (topic != "status" && !wanted_.has_topic(topic))
            return true;
        if (!detail::check_map(frames.payload, topic, head_, reason_) ||
            !detail::read_head(topic, head_, now_s, unix_s, message_, reason_))
            return false;
        // Until the daemon has a hello of its board, its status has no board name.
        is_message_ = wanted_.has_board(message_.board) || (message_.board.empty() && topic == "status");
        return true;
    }

    void report_malformed(Items& out)
    {
        ++malformed_;
        out.add(Kind::MALFORMED).reason = reason_;
    }

    // Take note of the numbers of messages that a status says were sent.
    void expect_sent(double now_s, Items& out)
    {
        const std::string_view sent = detail::find(status_, "sent");
        if (!detail::Values(sent).is_map())
            return;
        detail::read_entries(sent, counts_);
        detail::keep_last(counts_);
        for (const auto& [topic, value] : counts_) {
            std::uint64_t count = 0;
            if (detail::read_count(value, count) && wanted_.has_topic(topic))
                catch_up_.expect(message_.board, topic, count, now_s, out);
        }
    }

    void watch_age(double now_s, double unix_s, Items& out)
    {
        status_s_ = now_s;
        const double ahead_s = message_.timestamp - unix_s;
        const bool is_recent = std::abs(ahead_s) <= stale_after_s_;
        Heard heard{message_.run, now_s, "", std::max(-ahead_s, behind_s(now_s, is_recent)), now_s};
        if (ahead_s > stale_after_s_) {
            heard.fault = words("status from %.1f s ahead: the clocks differ", ahead_s);
        } else if (heard.silent_s > stale_after_s_) {
            heard.fault = words("reading %.1f s behind: messages wait, or the clocks differ", heard.silent_s);
        } else if (!detail::is_true(detail::find(status_, "valid"))) {
            detail::read_float(detail::find(status_, "age_s"), heard.silent_s);
            heard.fault = text("state") + ": " + text("reason");
        }
        hear(std::move(heard));
        for (const auto& [board, newest] : heard_) {
            const double silent_s = now_s - newest.at_s;
            const bool is_silent = silent_s >= stale_after_s_;
            if (newest.fault.empty() && !is_silent)
                continue;
            const std::string fault = is_silent ? words("no status read for %.1f s", silent_s) : newest.fault;
            const std::string name = board.empty() ? "without a name" : board;
            const std::string whose = heard_.size() > 1 ? "board " + name + ": " : "";
            turn_stale(whose + fault, is_silent ? silent_s : newest.silent_s, out);
            return;
        }
        if (now_s >= catch_up_.waits_from_s() + CatchUp::WAITS_S)
            return;  // `tick` has reported it
        if (state_ != State::FRESH) {
            state_ = State::FRESH;
            out.add(Kind::FRESH);
        }
    }

    // Newest status of a board.
    struct Heard {
        std::int64_t run;
        double at_s;
        std::string fault;  // why its data may be old; empty where they are fresh
        double silent_s;    // age of its newest data
        double since_s;     // time of its first status
    };

    // Keep the newest status of a board. A silent one has another name now if a new name has appeared since: a daemon
    // sends the status of each of its boards, ten times a second, without a name until it has a hello.
    void hear(Heard heard)
    {
        const auto before = heard_.find(message_.board);
        if (before != heard_.end() && before->second.run == heard.run)
            heard.since_s = before->second.since_s;
        double new_s = heard.since_s;
        for (const auto& entry : heard_)
            if (entry.second.run == heard.run)
                new_s = std::max(new_s, entry.second.since_s);
        for (auto it = heard_.begin(); it != heard_.end();) {
            const double at_s = it->second.at_s;
            const bool is_kept = it->second.run == heard.run && (at_s > heard.at_s - stale_after_s_ ||
                                                                 (!it->first.empty() && at_s >= new_s));
            it = is_kept ? std::next(it) : heard_.erase(it);
        }
        const std::string& board = message_.board;
        if (!heard_.count(board))
            heard_.erase("");  // it is the one that had no name, or that will be heard again
        if (!wanted_.board.empty()) {
            if (board.empty() && heard_.count(wanted_.board))
                return;  // of another board
            if (!heard_.count(board))
                heard_.clear();
        }
        if (heard_.count(board) || heard_.size() < MOST_BOARDS)
            heard_[board] = std::move(heard);
    }

    // Seconds that a status waited to be read, by the monotonic clocks of daemon and client. `is_recent`: by the
    // wall clock, it did not wait. Monotonic clocks stand still while a host sleeps.
    double behind_s(double now_s, bool is_recent)
    {
        double uptime_s = 0.0;
        if (!detail::read_float(detail::find(status_, "uptime_s"), uptime_s))
            return 0.0;
        const double lead_s = now_s - uptime_s;  // offset of both clocks plus the waiting time of this status
        const double allowed_s = least_lead_s_ + CLOCKS_PART * (now_s - lead_at_s_);
        const bool differ = is_recent && lead_s - allowed_s > stale_after_s_;
        differ_s_ = differ ? std::min(differ_s_, now_s) : INF;
        if (lead_run_ != message_.run || lead_s < allowed_s || now_s >= differ_s_ + ASLEEP_S) {
            lead_run_ = message_.run;
            least_lead_s_ = lead_s;
            lead_at_s_ = now_s;
            return 0.0;
        }
        return lead_s - allowed_s;
    }

    void turn_stale(std::string reason, double silent_s, Items& out)
    {
        if (state_ == State::STALE)
            return;
        state_ = State::STALE;
        Item& item = out.add(Kind::STALE);
        item.reason = std::move(reason);
        item.silent_s = silent_s;
    }

    // Text in a field of the present status.
    std::string text(const char* key) const
    {
        const std::string_view value = detail::find(status_, key);
        return detail::Values(value).is_text() ? std::string(detail::text_of(value)) : "unknown";
    }

    static std::string words(const char* format, double seconds)
    {
        char text[512];  // the largest float has 309 digits before the point
        std::snprintf(text, sizeof text, format, seconds);
        return text;
    }

    Wanted wanted_;
    CatchUp catch_up_;
    double stale_after_s_, status_s_;
    State state_ = State::UNKNOWN;
    std::map<std::string, Heard> heard_;  // by board
    std::optional<std::int64_t> lead_run_;  // run, least lead of a status, and when
    double least_lead_s_ = 0.0, lead_at_s_;
    double differ_s_ = INF;  // since then, the monotonic clocks alone say that each status is old
    std::uint64_t malformed_ = 0;
    // Of the message that is read now; members, so that their memory is used again.
    detail::Head head_;
    std::vector<detail::Entry> status_, counts_;  // of a status, and of its `sent`
    Message message_;
    bool is_message_ = false;
    std::string reason_;
};

}  // namespace tactiled
