// Items of a subscription, as in tactiled.client.items, and the queue that they wait in.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "tactiled_message.hpp"

namespace tactiled {

// What an item is.
enum class Kind {
    MESSAGE,    // a message, in the order of its topic
    RECOVERED,  // an old message: it was missed and requested again, or waited for over 0.2 s while an earlier
                // one of its topic was requested
    LOST,       // `count` messages of a topic were sent, did not arrive, and cannot be recovered
    RESTARTED,  // the daemon was restarted; how many messages of its last run were lost at its end is not
                // known
    STALE,      // data may be old from now on: do not act on them until FRESH
    FRESH,      // the board runs, and arriving data are new
    MALFORMED,  // received data that are no message of tactiled
};

// What a subscription returns. Its kind tells which fields have a meaning; the others are empty or old.
struct Item {
    Kind kind = Kind::MESSAGE;
    Message message;          // MESSAGE, RECOVERED
    std::string topic;        // LOST
    std::string board;        // LOST, RESTARTED
    std::uint64_t count = 0;  // LOST
    std::string reason;       // STALE, MALFORMED
    double silent_s = 0.0;    // STALE: age of the newest data
};

// Queue of items inside a subscription. Its memory is used again once all were taken.
class Items {
public:
    // Add an item and return it, so that its fields can be filled.
    Item& add(Kind kind)
    {
        if (end_ == slots_.size())
            slots_.emplace_back();
        slots_[end_].kind = kind;
        return slots_[end_++];
    }

    // Oldest item, valid until the next call of `add` or `take`; nullptr for none.
    const Item* take()
    {
        if (first_ < end_)
            return &slots_[first_++];
        first_ = end_ = 0;
        return nullptr;
    }

    bool empty() const { return first_ == end_; }

private:
    std::vector<Item> slots_;
    std::size_t first_ = 0, end_ = 0;
};

// Topics and board that a subscription takes; empty for all.
struct Wanted {
    std::vector<std::string> topics;
    std::string board;

    bool has_topic(std::string_view topic) const
    {
        return topics.empty() || std::find(topics.begin(), topics.end(), topic) != topics.end();
    }
    bool has_board(std::string_view name) const { return board.empty() || name == board; }
};

}  // namespace tactiled
