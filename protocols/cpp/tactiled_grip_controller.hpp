// Controller of a grasp: as little force as is safe, from `grip` messages alone.
//
//     tactiled::GripController controller;
//     // for each grip message that is fresh, with the force that the gripper exerts now:
//     gripper.move(controller.take(grip, gripper.force_n()));
//     // whenever tactile data are stale:
//     gripper.move(controller.blind());
//
// The same as tactiled.client.GripController; a test plays the same messages to both. docs/hold.md says what it assumes
// of a hand, and what it does in each situation.
//
// Needs C++17 and tactiled_events.hpp. No input, no output, no clock: times are those of the messages.
#pragma once

#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <stdexcept>
#include <string>

#include "tactiled_events.hpp"

namespace tactiled {

// Computes the force to grip with, in newtons. A controller is for one grasp with one board: stop it before the
// object is set down, and make a new one for the next grasp.
class GripController {
public:
    static constexpr double PRESS_S = 0.6;      // from touch: the grip is kept, until the zero of shear is known
    static constexpr double TARGET = 0.9;       // part of the friction bound that is used to hold an object
    static constexpr double GRASP_AGAIN = 1.4;  // times the present force, where all of the contact slides
    static constexpr double GONE_S = 0.2;       // without contact: the object has left the hand
    static constexpr double BLIND = 1.3;        // times the force that was wanted last, while data are stale

    // `target`: shear over load, divided by the friction bound, at which the object is held. `start_n`: force before
    // the object's weight is felt. `least_n`, `most_n`: limits of the force. Throws std::invalid_argument where a
    // number is not finite, or the limits are not in order.
    explicit GripController(double target = TARGET, double start_n = 6.0, double least_n = 1.0,
                            double most_n = 40.0)
        : target_(target), least_n_(least_n), most_n_(most_n), command_n_(limited(start_n))
    {
        if (!(0 < target && std::isfinite(target) && 0 <= least_n && least_n <= most_n && std::isfinite(most_n) &&
              std::isfinite(start_n)))
            throw std::invalid_argument(
                "GripController: wanted are finite numbers with target > 0 and 0 <= least_n <= most_n");
        new_object();
    }

    // Newest force to command; before the first message, `start_n` within the limits.
    double command_n() const { return command_n_; }

    // Return the force to command, from a message and the force that the gripper exerts now. Call it with each
    // message while data are fresh. A message of another board, or with impossible numbers, changes nothing.
    // A `present_n` that is not above 0 is replaced by an estimate from the load.
    double take(const Grip &grip, double present_n)
    {
        if (!is_usable(grip) || (!grip.board.empty() && !board_.empty() && grip.board != board_))
            return command_n_;
        if (grip.timestamp < contact_s_)
            shift_times(contact_s_ - grip.timestamp);
        if (grip.state == Grip::STATE_NONE) {
            if (grip.valid) {
                left_s_ = grip.timestamp;
                wanted_n_ = 0;
            }
            return command_n_;
        }
        if (grip.timestamp > left_s_ + GONE_S)
            new_object();
        left_s_ = INF;
        if (board_.empty())
            board_ = grip.board;
        contact_s_ = grip.timestamp;
        touched_s_ = std::min(touched_s_, grip.timestamp);
        // An incipient slip makes the state partial, also of a contact whose beginning nobody saw.
        if (grip.state != Grip::STATE_UNKNOWN && grip.state != Grip::STATE_PARTIAL)
            most_unseen_n_ = INF;
        else if (grip.state == Grip::STATE_UNKNOWN && grip.valid && most_unseen_n_ == INF)
            most_unseen_n_ = GRASP_MOST * command_n_;
        if (grip.timestamp < touched_s_ + PRESS_S || !grip.valid || grip.late || grip.load < 1 / MOST)
            return command_n_;
        if (!(1 / MOST < present_n && present_n < MOST))
            present_n = newtons_per_reading_ > 0 ? newtons_per_reading_ * grip.load : command_n_;
        // Not std::hypot, whose last bit differs from that of other languages.
        const double shear = std::sqrt(grip.shear_x * grip.shear_x + grip.shear_y * grip.shear_y);
        const Seen now{grip.timestamp, shear, grip.load, present_n};
        const double step_s = past_.empty() ? 0.0 : std::min(now.at_s - past_.back().at_s, 0.1);
        const bool dropped = drops(now);
        const double ratio = slip_ratio(grip, now);
        bound_friction(grip, now, ratio, step_s);
        const bool slides = dropped || ratio > 0;
        const double ahead = now.shear + std::min(LEAD_S * growth(now), LEAD_MOST * now.shear);
        double wanted_n = wanted(grip.friction, now, ahead);
        if (slides) {
            double again_n = std::min(GRASP_AGAIN * present_n, GRASP_MOST * before_slip_n_);
            if (grip.state != Grip::STATE_GROSS)  // an object that sways and sticks is not gripped ever harder
                again_n = std::min(again_n, newtons_per_reading_ * now.shear / (DENIED * grip.friction_low));
            wanted_n = std::max(wanted_n, again_n);
        } else {
            before_slip_n_ = command_n_;
        }
        wanted_n = std::min(wanted_n, most_unseen_n_);
        if (past_.empty())
            calm_from_s_ = now.at_s + CALM_AFTER_STALE_S;
        else if (slides)
            calm_from_s_ = std::max(now.at_s + CALM_AFTER_SLIP_S, calm_from_s_);
        else if (wanted_n > command_n_ || ahead > (1 + GROWS) * now.shear || now.shear < LEAST * now.load)
            calm_from_s_ = std::max(now.at_s + CALM_S, calm_from_s_);
        wanted_n_ = wanted_n;
        if (wanted_n > command_n_)
            command_n_ = wanted_n;
        else if (now.at_s > calm_from_s_)
            command_n_ -= EASE_PER_S * step_s * (command_n_ - wanted_n);
        command_n_ = limited(command_n_);
        past_.push_back(now);
        while (past_.front().at_s < now.at_s - REST_S)
            past_.pop_front();
        return command_n_;
    }

    // Return the force to command while tactile data are stale: tighter, and not eased. Call it at Kind::STALE,
    // and go on with `take` once data are fresh.
    double blind()
    {
        command_n_ = limited(std::max(command_n_, BLIND * wanted_n_));
        past_.clear();
        left_s_ = INF;
        return command_n_;
    }

private:
    static constexpr double INF = std::numeric_limits<double>::infinity();
    static constexpr double SURELY = 0.87, FORGET_PER_S = 0.01, RENEW_PER_S = 0.3, GREW = 1.02;
    static constexpr double LEAD_S = 0.08, LEAD_MOST = 0.5, GROWTH_S = 0.03, GROWS = 0.08, LEAST = 0.05;
    static constexpr double DROP = 0.03, DROP_PER_S = 1.0, FLAT_PER_S = 1.0, FLAT_S = 0.009, DROP_S = 0.035;
    static constexpr double PEAK = 0.93, TIGHTENED = 0.5, REST_S = 0.6;
    static constexpr double FOLLOWS = 0.6, FOLLOW_S = 0.2, FOLLOWS_ON = 0.25, CHANGED = 0.03, WATCH_S = 0.3;
    static constexpr double PLATEAU_S = 0.15, PLATEAU = 1.03, WEAKER = 0.7, RECOVER_PER_S = 0.05, GRASP_MOST = 1.7, DENIED = 0.4;
    static constexpr double CALM_S = 0.1, CALM_AFTER_SLIP_S = 0.3, CALM_AFTER_STALE_S = 1.0, EASE_PER_S = 4.0;
    static constexpr double STEADY = 0.03, STEADY_S = 0.1, UNSTEADY = 1.2, MOST = 1e50;

    struct Seen {
        double at_s, shear, load, force_n;
    };

    double limited(double force_n) const { return std::min(std::max(force_n, least_n_), most_n_); }

    // True where each number that is used is possible; friction is of a contact alone.
    static bool is_usable(const Grip &grip)
    {
        const std::string states[] = {Grip::STATE_NONE, Grip::STATE_STICKING, Grip::STATE_PARTIAL,
                                      Grip::STATE_GROSS, Grip::STATE_UNLOADING, Grip::STATE_UNKNOWN};
        if (std::find(std::begin(states), std::end(states), grip.state) == std::end(states))
            return false;
        for (double number : {grip.timestamp, grip.shear_x, grip.shear_y, grip.load})
            if (!(std::abs(number) < MOST))
                return false;
        if (grip.state == Grip::STATE_NONE)
            return true;
        return 1 / MOST < grip.friction_low && grip.friction_low < MOST && 1 / MOST < grip.friction && grip.friction < MOST;
    }

    // Follow a clock that was set back: what was measured before is as old as it was.
    void shift_times(double by_s)
    {
        past_.clear();
        contact_s_ -= by_s;
        left_s_ -= by_s;
        touched_s_ -= by_s;
        dropped_s_ -= by_s;
        steady_from_s_ -= by_s;
    }

    // Begin with another object.
    void new_object()
    {
        board_.clear();
        friction_ = 0.0;
        slid_ratio_ = touched_s_ = left_s_ = most_unseen_n_ = INF;
        slides_ = false;
        past_.clear();
        contact_s_ = dropped_s_ = -INF;
        calm_from_s_ = level_n_ = newtons_per_reading_ = steady_from_s_ = 0.0;
        before_slip_n_ = command_n_;
    }

    // Keep the highest bound of friction; a slip lowers it, to the ratio at which the object slid.
    void bound_friction(const Grip &grip, const Seen &now, double ratio, double step_s)
    {
        const bool grows = !past_.empty() && now.shear > GREW * past_.front().shear;
        slid_ratio_ *= 1 + RECOVER_PER_S * step_s;
        if (ratio > 0 && !slides_)
            slid_ratio_ = std::max(ratio, WEAKER * std::max(friction_, grip.friction_low));
        slides_ = ratio > 0;
        friction_ *= 1 - (grows ? RENEW_PER_S : FORGET_PER_S) * step_s;
        friction_ = std::max(friction_, grip.friction_low);
        friction_ = std::min({friction_, slid_ratio_, SURELY * grip.friction});
    }

    // Force that holds what is borne now at the target, and what is borne soon by likely friction.
    double wanted(double friction, const Seen &now, double ahead)
    {
        const double newtons = newtons_per_load(now);
        const double likely = std::max(std::sqrt(friction_ * friction), friction_);
        return newtons * std::max(now.shear / (friction_ * target_), ahead / likely);
    }

    // Force over load reading, measured while the grip is steady: message and gripper differ in age.
    double newtons_per_load(const Seen &now)
    {
        if (std::abs(now.force_n - level_n_) > STEADY * level_n_) {
            level_n_ = now.force_n;
            steady_from_s_ = now.at_s + STEADY_S;
        }
        const double present = now.force_n / now.load;
        if (now.at_s >= steady_from_s_ || newtons_per_reading_ == 0.0)
            newtons_per_reading_ = present;
        return std::min(std::max(present, newtons_per_reading_), UNSTEADY * newtons_per_reading_);
    }

    // Oldest message that is kept from an instant on; past_.end() without one.
    std::deque<Seen>::const_iterator since(double at_s) const
    {
        return std::find_if(past_.begin(), past_.end(), [at_s](const Seen &seen) { return seen.at_s >= at_s - 1e-3; });
    }

    double growth(const Seen &now) const
    {
        if (past_.empty())
            return 0.0;
        const auto found = since(now.at_s - GROWTH_S);
        const Seen &then = found == past_.end() ? past_.back() : *found;
        return std::max(now.shear - then.shear, 0.0) / std::max(now.at_s - then.at_s, 1e-3);  // may come twice
    }

    // True where the largest shear of late has just fallen at once, and falls no further.
    bool drops(const Seen &now)
    {
        const auto weaker = [](const Seen &a, const Seen &b) { return a.shear < b.shear; };
        const auto recent = since(now.at_s - DROP_S);
        if (recent == past_.end() || now.shear < LEAST * now.load)
            return false;
        const Seen &peak = *std::max_element(recent, past_.cend(), weaker);
        const double largest = std::max_element(past_.begin(), past_.end(), weaker)->shear;
        const double least_drop = std::max(DROP, DROP_PER_S * (now.at_s - peak.at_s)) +
                                  TIGHTENED * std::max(now.load / peak.load - 1, 0.0);
        auto before = past_.cend() - 1;
        while (before != recent && before->at_s > now.at_s - FLAT_S)
            --before;
        const double least = (1 - FLAT_PER_S * (now.at_s - before->at_s)) * before->shear;
        const bool found =
            peak.shear >= PEAK * largest && least < now.shear && now.shear < (1 - least_drop) * peak.shear;
        if (found)
            dropped_s_ = now.at_s;
        return found;
    }

    // Shear over load at which the object slides, 0 where it does not.
    double slip_ratio(const Grip &grip, const Seen &now) const
    {
        if (grip.state == Grip::STATE_GROSS)
            return now.shear / now.load;
        const bool watched = now.at_s < dropped_s_ + WATCH_S;
        const auto before = since(std::max(now.at_s - FOLLOW_S, dropped_s_ + 2e-3));
        const Seen &then = before == past_.end() ? now : *before;
        if (std::min(then.shear, now.shear) < LEAST * then.load || std::min(then.force_n, now.force_n) <= 0)
            return 0.0;
        const double tightened = std::log(now.force_n / then.force_n), grown = std::log(now.shear / then.shear);
        bool follows;
        if (watched) {
            follows = tightened > CHANGED && FOLLOWS_ON < grown / tightened && grown / tightened < 1.1;
        } else {
            double least = INF;
            for (auto seen = since(then.at_s - PLATEAU_S); seen != past_.end() && seen->at_s < then.at_s; ++seen)
                least = std::min(least, seen->shear);
            const bool was_steady = least < INF && then.shear < PLATEAU * least;
            follows = was_steady && tightened < -CHANGED && grown < FOLLOWS * tightened;
        }
        return follows ? std::max(then.shear / then.load, DENIED * grip.friction_low) : 0.0;
    }

    double target_, least_n_, most_n_, command_n_;
    double friction_, slid_ratio_;  // shear over load that is borne with 95 %, and at the last slip
    bool slides_;
    // Most force in a contact whose beginning nobody saw: what pressing makes of its shear grows with the grip.
    double most_unseen_n_;
    std::string board_;  // of the contact; empty until a board has said its name
    std::deque<Seen> past_;
    double touched_s_, contact_s_, left_s_, calm_from_s_, dropped_s_;
    double wanted_n_ = 0;  // by the newest message of a contact
    double before_slip_n_, level_n_, newtons_per_reading_, steady_from_s_;
};

}  // namespace tactiled
