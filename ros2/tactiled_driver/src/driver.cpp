// Lifecycle node that publishes the messages of one board: wrench, taxels, tactiled_msgs, /diagnostics.
//
//     ros2 run tactiled_driver driver --ros-args -p board:=TS0001 -p autostart:=true -r __ns:=/tactile/TS0001
//
// A thread receives and publishes while the node is active, so that no message waits for the executor.
// docs/ros2.md has the rules for what is published.
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <lifecycle_msgs/msg/state.hpp>
#include <memory>
#include <mutex>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>
#include <stdexcept>
#include <string>
#include <string_view>
#include <tactiled.hpp>
#include <thread>
#include <tuple>
#include <type_traits>
#include <vector>

#include "tactiled_driver/conversions.hpp"
#include "tactiled_driver/own_messages.hpp"

namespace tactiled_driver {

using geometry_msgs::msg::WrenchStamped;
using sensor_msgs::msg::PointCloud2;
using rclcpp_lifecycle::LifecycleNode;
using Result = LifecycleNode::CallbackReturn;

constexpr double WAIT_S = 0.05;        // the thread ends within this time
constexpr std::size_t N_EVENTS = 100;  // queue of a reliable topic

// True where a message that is published now has a receiver. Without one, converting and writing it would keep the
// processor from the receivers of others.
template <class Publisher> bool has_receiver(const Publisher& publisher)
{
    return publisher.get_subscription_count() + publisher.get_intra_process_subscription_count() > 0;
}

// Topic of tactiled_msgs.
template <class Own, class Ros> struct Topic {
    static constexpr const char* NAME = Own::TOPIC;

    typename rclcpp_lifecycle::LifecyclePublisher<Ros>::SharedPtr publisher;
    bool is_kept = false;  // for late subscribers
    Own own;               // newest message; kept, as `ros` is, because their memory is used again
    Ros ros;

    void publish(const std::string& frame_id)
    {
        if (!is_kept && !has_receiver(*publisher))
            return;
        convert(own, ros, frame_id);
        publisher->publish(ros);
    }
};

namespace msg = tactiled_msgs::msg;
using Contacts = Topic<tactiled::Contact, msg::Contact>;
using Infos = Topic<tactiled::Info, msg::Info>;
using Topics =
    std::tuple<Topic<tactiled::Force, msg::Force>, Topic<tactiled::Grip, msg::Grip>, Topic<tactiled::Scan, msg::Scan>,
               Topic<tactiled::Slip, msg::Slip>, Contacts, Topic<tactiled::Texture, msg::Texture>,
               Infos, Topic<tactiled::Status, msg::Status>, Topic<tactiled::Recording, msg::Recording>,
               Topic<tactiled::Command, msg::Command>>;

class Driver final : public LifecycleNode {
public:
    explicit Driver(const rclcpp::NodeOptions& options) : LifecycleNode("tactiled_driver", options)
    {
        declare_parameter("endpoint", tactiled::DEFAULT_ENDPOINT);
        declare_parameter("board", "");
        declare_parameter("frame_id", "");
        declare_parameter("qos", "sensor_data");
        declare_parameter("calibrated_only", true);
        if (declare_parameter("autostart", false) &&
            configure().id() == lifecycle_msgs::msg::State::PRIMARY_STATE_INACTIVE)
            activate();
    }

    ~Driver() override { end_thread(); }

    Result on_configure(const rclcpp_lifecycle::State&) override
    {
        try {
            open();
        } catch (const std::exception& error) {
            RCLCPP_ERROR(get_logger(), "%s", error.what());
            close();
            return Result::FAILURE;
        }
        return Result::SUCCESS;
    }

    Result on_activate(const rclcpp_lifecycle::State& state) override
    {
        tactiled::Options options;
        options.board = state_.board;
        try {
            events_ = std::make_unique<tactiled::Subscription>(get_parameter("endpoint").as_string(), topic_names(),
                                                               options);
        } catch (const tactiled::Error& error) {
            RCLCPP_ERROR(get_logger(), "parameter endpoint: %s", error.what());
            return Result::FAILURE;
        }
        is_ending_ = false;
        state_.is_active = true;
        const Result result = LifecycleNode::on_activate(state);  // first: until then, all is lost
        thread_ = std::thread([this] { listen(); });
        return result;
    }

    Result on_deactivate(const rclcpp_lifecycle::State& state) override
    {
        deactivate_board();
        return LifecycleNode::on_deactivate(state);
    }

    Result on_cleanup(const rclcpp_lifecycle::State&) override
    {
        close();
        return Result::SUCCESS;
    }

    Result on_shutdown(const rclcpp_lifecycle::State&) override
    {
        deactivate_board();
        close();
        return Result::SUCCESS;
    }

private:
    // Read the parameters and create the publishers.
    void open()
    {
        state_ = BoardState();
        n_unread_ = 0;
        state_.board = get_parameter("board").as_string();
        if (state_.board.empty())
            throw std::invalid_argument("parameter board: set it to the serial number that `tactiled listen` shows");
        frame_id_ = get_parameter("frame_id").as_string();
        if (frame_id_.empty())
            frame_id_ = frame_of(state_.board);
        calibrated_only_ = get_parameter("calibrated_only").as_bool();
        const rclcpp::QoS scans = qos_of_scans(get_parameter("qos").as_string());
        std::apply([&](auto&... topic) { (open(topic, scans), ...); }, topics_);
        wrenches_ = create_publisher<WrenchStamped>("wrench", scans);
        clouds_ = create_publisher<PointCloud2>("taxels", scans);
        // Not of the lifecycle: the diagnostics say so while the node is not active.
        diagnostics_ = rclcpp::create_publisher<diagnostic_msgs::msg::DiagnosticArray>(*this, "/diagnostics",
                                                                                      rclcpp::QoS(N_EVENTS));
        timer_ = create_wall_timer(std::chrono::seconds(1), [this] { diagnose(); });
    }

    template <class Own, class Ros> void open(Topic<Own, Ros>& topic, const rclcpp::QoS& scans)
    {
        const std::string_view name = topic.NAME;
        const bool is_kept = name == "contact" || name == "info";
        rclcpp::QoS qos(N_EVENTS);
        if (name == "scan" || name == "force" || name == "grip")
            qos = scans;
        else if (name == "contact")
            qos = rclcpp::QoS(1).transient_local();
        else if (name == "info")
            qos = rclcpp::QoS(1).transient_local().lifespan(std::chrono::seconds(3));
        topic = {create_publisher<Ros>(topic.NAME, qos), is_kept, Own(), Ros()};
    }

    static rclcpp::QoS qos_of_scans(const std::string& name)
    {
        if (name == "sensor_data")
            return rclcpp::SensorDataQoS();
        if (name == "reliable")
            return rclcpp::QoS(N_EVENTS);
        throw std::invalid_argument("parameter qos: '" + name + "' is neither sensor_data nor reliable");
    }

    void close()
    {
        timer_.reset();
        diagnostics_.reset();
        wrenches_.reset();
        clouds_.reset();
        std::apply([](auto&... topic) { (topic.publisher.reset(), ...); }, topics_);
    }

    static std::vector<std::string> topic_names()
    {
        return std::apply(
            [](const auto&... topic) { return std::vector<std::string>{std::decay_t<decltype(topic)>::NAME...}; },
            Topics());
    }

    void listen()
    {
        while (!is_ending_) {
            const tactiled::Item* item = nullptr;
            bool is_refused = false;
            try {
                item = events_->next(tactiled::monotonic_s() + WAIT_S);
            } catch (const std::exception&) {
                is_refused = true;
            }
            const std::lock_guard<std::mutex> lock(mutex_);
            state_.refused += is_refused;
            try {
                watch();
                if (item && item->kind == tactiled::Kind::MESSAGE)  // others are old, or show in the diagnostics
                    take(item->message);
                watch();
            } catch (const std::exception&) {
                ++state_.refused;
            }
            state_.lost = events_->lost();
            state_.malformed = events_->malformed() + n_unread_;
        }
    }

    void take(const tactiled::Message& message)
    {
        const double now_s = tactiled::monotonic_s();
        if (!std::apply([&](auto&... topic) { return (take(topic, message, now_s) || ...); }, topics_))
            ++n_unread_;
    }

    // Take a message that belongs to this topic, and publish it while it is fresh; false for one of another topic.
    template <class Own, class Ros> bool take(Topic<Own, Ros>& topic, const tactiled::Message& message, double now_s)
    {
        if (!message.read(topic.own))
            return false;
        const double age_s = message.age_s(now_s);
        if constexpr (std::is_same_v<Own, tactiled::Status>)
            state_.take(topic.own, age_s, now_s);
        if (!state_.admit(topic.NAME, age_s, now_s))
            return true;
        if constexpr (std::is_same_v<Own, tactiled::Force>)
            publish_newtons(topic.own);
        if constexpr (std::is_same_v<Own, tactiled::Contact>)
            state_.contact = topic.own.state;
        topic.publish(frame_id_);
        return true;
    }

    // Publish the standard messages of a force.
    void publish_newtons(const tactiled::Force& force)
    {
        state_.calibration = force.calibration;
        if (!is_in_newtons(force, calibrated_only_))
            return;
        if (has_receiver(*wrenches_)) {
            convert(force, wrench_, frame_id_);
            wrenches_->publish(wrench_);
        }
        if (has_receiver(*clouds_) && convert(force, std::get<Infos>(topics_).own, cloud_, frame_id_))
            clouds_->publish(cloud_);
    }

    // Replace the latched contact when the board becomes stale, when it is fresh again, and when one was missed.
    void watch()
    {
        const auto contact = state_.changed_contact(tactiled::monotonic_s(), tactiled::unix_s());
        if (!contact)
            return;
        auto& contacts = std::get<Contacts>(topics_);
        contacts.own = *contact;
        contacts.publish(frame_id_);
    }

    void diagnose()
    {
        const std::lock_guard<std::mutex> lock(mutex_);
        diagnostics_->publish(diagnostics(state_, tactiled::monotonic_s(), tactiled::unix_s()));
    }

    void end_thread()
    {
        is_ending_ = true;
        if (thread_.joinable())
            thread_.join();
        events_.reset();
    }

    // End the thread, and replace the latched contact while its publisher is active.
    void deactivate_board()
    {
        end_thread();
        state_.is_active = false;
        watch();
    }

    std::string frame_id_;
    bool calibrated_only_ = true;
    Topics topics_;
    rclcpp_lifecycle::LifecyclePublisher<WrenchStamped>::SharedPtr wrenches_;
    WrenchStamped wrench_;
    rclcpp_lifecycle::LifecyclePublisher<PointCloud2>::SharedPtr clouds_;
    PointCloud2 cloud_;
    rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr diagnostics_;
    rclcpp::TimerBase::SharedPtr timer_;
    std::unique_ptr<tactiled::Subscription> events_;  // belongs to the thread while that runs
    std::thread thread_;
    std::atomic<bool> is_ending_ = false;
    std::mutex mutex_;  // guards what thread and executor share: `state_`
    BoardState state_;
    std::uint64_t n_unread_ = 0;  // messages without a field that this node needs: the daemon is older
};

}  // namespace tactiled_driver

RCLCPP_COMPONENTS_REGISTER_NODE(tactiled_driver::Driver)
