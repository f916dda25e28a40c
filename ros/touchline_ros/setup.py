from setuptools import setup

NAME = "touchline_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/touchline.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The Touchline developers",
    description="Touchline as a node of ROS 2",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"localization = {NAME}.node:main"]},
)
