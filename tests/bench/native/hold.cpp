// Grasp controller of C++ for a test: grip messages in, forces to command out.
//
// A line for each message: state, valid, late, then its numbers and the force that the gripper exerts; a line
// "blind" while there are none.
#include <iomanip>
#include <iostream>

#include "tactiled_grip_controller.hpp"

int main()
{
    tactiled::GripController controller;
    tactiled::Grip grip;
    double present_n = 0.0;
    std::cout << std::setprecision(17);
    while (std::cin >> grip.state) {
        if (grip.state == "blind") {
            std::cout << controller.blind() << std::endl;
            continue;
        }
        std::cin >> grip.valid >> grip.late >> grip.timestamp >> grip.load >> grip.shear_x >> grip.shear_y >>
            grip.friction_low >> grip.friction >> present_n;
        std::cout << controller.take(grip, present_n) << std::endl;
    }
}
