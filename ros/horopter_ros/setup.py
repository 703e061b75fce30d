from setuptools import setup

setup(
    name="horopter_ros",
    version="0.1.0",
    packages=["horopter_ros"],
    data_files=[("share/ament_index/resource_index/packages", ["resource/horopter_ros"]),
                ("share/horopter_ros", ["package.xml"])],
    install_requires=["setuptools", "horopter"],
    entry_points={"console_scripts": ["recognizer = horopter_ros.node:main"]},
)
