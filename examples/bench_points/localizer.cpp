// A localizer for `touchline bench points FILE.npz --program ./localizer`: it answers with what it was told.
// g++ -O2 -std=c++17 localizer.cpp -o localizer
#include <array>
#include <iostream>
#include <string>
#include <vector>

int main() {
    std::cout.precision(17);
    std::string word, kind;
    int version, segments, arcs, count;
    std::cin >> word >> version >> segments >> arcs;
    std::vector<double> lines(4 * segments), bows(5 * arcs);  // x1 y1 x2 y2; cx cy radius start end
    for (double& value : lines) std::cin >> value;
    for (double& value : bows) std::cin >> value;
    while (std::cin >> kind) {
        std::array<double, 3> told{};
        for (int i = 0, n = kind == "init" ? 3 : kind == "compass" ? 1 : 0; i < n; ++i) std::cin >> told[i];
        std::cin >> count;
        std::vector<double> points(2 * count);  // x y of each, robot frame
        for (double& value : points) std::cin >> value;
        if (kind != "init") std::cout << "none" << std::endl;  // your own localizer goes here
        else std::cout << told[0] << ' ' << told[1] << ' ' << told[2] << std::endl;
    }
}
